"""Localization by direct alignment of the features of any network."""
