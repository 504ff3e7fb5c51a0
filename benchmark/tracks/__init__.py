"""Tracks: data sets of places that are alike, rendered or real, with the results of all methods."""
