"""Coarse search: candidate poses of a query of which position or heading is unknown.

``grid`` divides the ground into cells, ``mosaic`` holds their features from the map's photographs,
``search`` correlates a query with the mosaic over headings and altitudes.
"""
