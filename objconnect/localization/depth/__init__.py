"""Depth of the pixels of a map's photographs by a plane sweep."""
