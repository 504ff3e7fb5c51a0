"""Pairs of orthophotos: a map of one date, and query photographs rendered from the other."""
