"""Checks that a scene keeps its conventions."""
