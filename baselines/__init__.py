"""Baseline localizers, all behind ``objconnect.scene.localizer.Localizer``."""
