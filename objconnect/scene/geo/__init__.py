"""Coordinate reference systems and GeoTIFFs (extra ``[geo]``)."""
