"""Tracks: places rendered alike, their data sets, and the results that are kept of them."""
