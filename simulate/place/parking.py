"""Lay car parks with marked bays, about half of them occupied."""

from __future__ import annotations

import numpy as np

from simulate.place.objects import car, van
from simulate.place.site import Site
from simulate.place.streets import Frame

BAY_M = (2.6, 5.0)  # a parking bay
AISLE_M = 6.0  # between two rows of bays


def car_park(site: Site, at: Frame, length: float, rows: int) -> None:
    """Lay ``rows`` aisles with marked bays on both sides, about half of them occupied."""
    rng = site.rng
    wide, deep = BAY_M
    count = int((length - 1.0) / wide)
    pitch = 2 * deep + AISLE_M
    site.paint("parking", at.quad(0, length, -0.5, rows * pitch + 0.5), float(rng.random()))
    taken = rng.uniform(0.3, 0.75)
    for row in range(rows):
        for b0, b1 in ((0.0, deep), (deep + AISLE_M, pitch)):
            b0, b1 = b0 + row * pitch, b1 + row * pitch
            for i in range(count + 1):
                site.mark(at.point([0.5 + i * wide] * 2, [b0, b1]))
            for i in range(count):
                if not site.chance(taken):
                    continue
                a, b = 0.5 + (i + 0.5) * wide, 0.5 * (b0 + b1) + rng.normal(0, 0.15)
                yaw = at.yaw(a, b) + np.pi / 2 * site.choose((1, -1)) + rng.normal(0, 0.02)
                (car if site.chance(0.93) else van)(site, at.point(a, b), yaw)
    site.reserve(at.quad(0, length, 0, rows * pitch))
