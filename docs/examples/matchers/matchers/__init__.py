"""Localizers from the matchers of other packages: matches are lifted to map points for PnP."""
