"""Depth of pixels of a map's photographs by plane sweep."""
