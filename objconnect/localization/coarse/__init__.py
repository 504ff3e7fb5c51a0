"""Place search: where a query may be, when little or nothing is known of its pose.

``grid`` lays cells on the ground, ``mosaic`` keeps what they look like in the map's photographs,
``search`` correlates a query with the mosaic over headings and altitudes.
"""
