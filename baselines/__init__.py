"""Localizers to beat, all behind ``objconnect.scene.localizer.Localizer``."""
