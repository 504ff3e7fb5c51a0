"""The engine: features, matching, alignment, coarse search, tracking and the ``localize`` job."""
