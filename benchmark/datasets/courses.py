"""Courses: flights along the same path, whose queries are not independent samples.

A flight is repeated under another condition, with a second camera, or over another rendered site
with the same random seed. Both flights then have the same heights, tilts and overlaps, and often
show the same ground, so that the same photographs of each tend to fail.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

SAME_COURSE_M: Final = 10.0
"""Two flights are on one course if the median distance between cameras with the same index is below
this, metres. The median is 40 m or more between independent random flights over a square of 220 m,
up to 14 m between drives along one street, some of which are thus on different courses, and 1 m
between repeated surveys.
"""


def find_courses(flights: Mapping[str, NDArray[np.float64]]) -> dict[str, str]:
    """Return the course of each flight: the name of the first flight that is on it.

    Two flights are on one course if they have equally many cameras and the median of the horizontal
    distances between cameras with the same index is below ``SAME_COURSE_M``, or if both are on one
    course with a third. Heights are left out, because they follow the ground of each place.

    Args:
        flights: camera centres (N, 3) of each flight in flying order, world metres.
    """
    course = {name: name for name in flights}
    for first, second in combinations(flights, 2):
        if course[first] != course[second] and _are_near(flights[first], flights[second]):
            replaced = course[second]
            course = {n: course[first] if c == replaced else c for n, c in course.items()}
    return course


def _are_near(centres: NDArray[np.float64], others: NDArray[np.float64]) -> bool:
    if len(centres) != len(others):
        return False
    return float(np.median(np.linalg.norm((centres - others)[:, :2], axis=1))) < SAME_COURSE_M
