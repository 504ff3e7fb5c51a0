"""Diagnosis of maps: which objects of the photographs have points, and how exact the points are."""
