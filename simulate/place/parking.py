"""Lay car parks with marked bays, about half of them occupied.

Local coordinates (a, b) are metres along a street and away from it, see ``StreetFrame``.
"""

from __future__ import annotations

import numpy as np

from simulate.place.builder import PlaceBuilder
from simulate.place.objects import car, van
from simulate.place.streets import StreetFrame

BAY_M = (2.6, 5.0)  # width and length of a parking bay
AISLE_M = 6.0  # width of the aisle between two rows of bays


def car_park(builder: PlaceBuilder, frame: StreetFrame, length: float, rows: int) -> None:
    """Lay ``rows`` aisles of ``length`` metres from a frame's origin, with bays on both sides."""
    rng = builder.rng
    bay_width, bay_length = BAY_M
    count = int((length - 1.0) / bay_width)
    row_depth = 2 * bay_length + AISLE_M
    builder.paint(
        "parking", frame.quad(0, length, -0.5, rows * row_depth + 0.5), float(rng.random())
    )
    occupied_share = rng.uniform(0.3, 0.75)
    for row in range(rows):
        for b0, b1 in ((0.0, bay_length), (bay_length + AISLE_M, row_depth)):
            b0, b1 = b0 + row * row_depth, b1 + row * row_depth
            for i in range(count + 1):
                builder.mark(frame.point([0.5 + i * bay_width] * 2, [b0, b1]))
            for i in range(count):
                if not builder.chance(occupied_share):
                    continue
                a, b = 0.5 + (i + 0.5) * bay_width, 0.5 * (b0 + b1) + rng.normal(0, 0.15)
                yaw = frame.yaw(a, b) + np.pi / 2 * builder.choose((1, -1)) + rng.normal(0, 0.02)
                (car if builder.chance(0.93) else van)(builder, frame.point(a, b), yaw)
    builder.reserve(frame.quad(0, length, 0, rows * row_depth))
