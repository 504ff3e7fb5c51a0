"""Coarse search: candidate poses of a query with unknown position or heading.

``grid`` divides the ground into cells, ``mosaic`` holds their features from the map's photographs,
``search`` compares a query with the mosaic over headings, tilts and altitudes, and ``refinement``
refines the best poses.
"""
