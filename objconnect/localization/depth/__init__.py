"""Depth of corners of a photograph of the map, by sweeping planes and windows."""
