"""Localizers to beat, all behind ``scene.localizer.Localizer``."""
