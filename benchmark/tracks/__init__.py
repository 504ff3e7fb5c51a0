"""Benchmark tracks: data sets of similar sites, rendered or real, with results of all methods."""
