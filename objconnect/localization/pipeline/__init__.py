"""Localize photographs, sequences and videos in a map, and write their poses."""
