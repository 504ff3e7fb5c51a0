"""Data sets that localizers are scored on, and a reader for each kind."""
