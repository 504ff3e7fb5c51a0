"""Pairs of orthophotos: a map of one date, and queries drawn from the other."""
