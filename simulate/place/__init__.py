"""Rendered places as plain data: terrain, ground cover, roads and objects."""
