"""Localization: features, matching, alignment, coarse search, tracking and ``localize``."""
