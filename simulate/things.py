"""Single things of every kind: their sizes, their colours, and how they are put down."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulate.site import Site
from simulate.streets import Frame
from simulate.styles import vary
from simulate.world import BuildingStyle, Rgb

Array = NDArray[np.float64]
Size = tuple[float, float, float]  # length, width, height in metres

# Linear albedo.
_PAINTS: tuple[Rgb, ...] = (
    (0.62, 0.62, 0.61),
    (0.30, 0.31, 0.32),
    (0.020, 0.021, 0.023),
    (0.075, 0.078, 0.085),
    (0.30, 0.022, 0.018),
    (0.025, 0.06, 0.19),
    (0.05, 0.09, 0.06),
    (0.38, 0.34, 0.27),
)
STEEL: tuple[Rgb, ...] = (
    (0.28, 0.050, 0.028),
    (0.035, 0.09, 0.22),
    (0.05, 0.15, 0.07),
    (0.42, 0.21, 0.04),
    (0.40, 0.40, 0.39),
    (0.17, 0.04, 0.03),
)
# Length, width, height in metres.
_CARS: dict[str, Size] = {
    "hatchback": (4.0, 1.76, 1.48),
    "saloon": (4.6, 1.82, 1.44),
    "estate": (4.7, 1.83, 1.50),
    "suv": (4.6, 1.90, 1.70),
}
_TRUCKS: dict[str, Size] = {
    "van": (5.6, 2.0, 2.45),
    "lorry": (8.4, 2.45, 3.4),
}
_BENCH_M: Size = (1.8, 0.65, 0.85)
LAMP_M: Size = (1.7, 0.24, 7.0)
CONTAINER_M: dict[str, Size] = {
    "container": (6.06, 2.44, 2.59),
    "long_container": (12.19, 2.44, 2.59),
}


def steel(site: Site) -> Rgb:
    return vary(site, site.choose(STEEL))


def building(
    site: Site, shape: str, at: Frame, a: float, b: float, size: Size, style: BuildingStyle
) -> bool:
    """A building facing the street of its frame, smaller when the warp leaves it less room."""
    for share in (1.0, 0.9, 0.8, 0.7):
        fitted = (size[0] * share, size[1] * share, size[2])
        if site.place("building", shape, at.point(a, b), fitted, at.yaw(a, b), style=style):
            return True
    return False


def tree(site: Site, at: Array, radius: float, conifers: float = 0.12) -> bool:
    rng = site.rng
    value, warm = rng.uniform(0.75, 1.3), rng.uniform(0.88, 1.18)
    colour = (value * warm, value, value)
    if site.chance(conifers):
        size = (1.5 * radius, 1.5 * radius, radius * rng.uniform(3.0, 4.2) + 1.0)
        shape = f"conifer_{rng.integers(3)}"
    else:
        size = (2 * radius, 2 * radius, radius * rng.uniform(2.1, 2.9) + 1.2)
        shape = f"broadleaf_{rng.integers(6)}"
    return site.place("tree", shape, at, size, rng.uniform(-np.pi, np.pi), colour)


def bench(site: Site, at: Array, yaw: float) -> bool:
    return site.place("bench", "bench", at, _BENCH_M, yaw, (0.20, 0.12, 0.07), gap_m=0.05)


def barrier(
    site: Site,
    kind: str,
    at: Frame,
    start: tuple[float, float],
    end: tuple[float, float],
    thick: float,
    high: float,
) -> None:
    """A straight hedge or fence between two local points; shortened ends keep corners apart."""
    p, q = at.point(*start), at.point(*end)
    length = float(np.linalg.norm(q - p)) - 0.3
    if length < 1.0:
        return
    yaw = float(np.arctan2(*(q - p)[::-1]))
    colour = vary(site, (1.0, 1.0, 1.0) if kind == "hedge" else (0.22, 0.16, 0.11))
    site.place(kind, kind, 0.5 * (p + q), (length, thick, high), yaw, colour, gap_m=0.02)


def car(site: Site, at: Array, yaw: float, gap_m: float = 0.15) -> bool:
    shape = site.choose(tuple(_CARS))
    paint = vary(site, site.choose(_PAINTS))
    return site.place(
        "car", shape, at, _CARS[shape], yaw, paint, on_road=True, on_reserved=True, gap_m=gap_m
    )  # fmt: skip


def van(site: Site, at: Array, yaw: float) -> bool:
    paint = vary(site, site.choose(_PAINTS[:4]))
    return site.place(
        "truck", "van", at, _TRUCKS["van"], yaw, paint, on_road=True, on_reserved=True
    )  # fmt: skip


def truck(site: Site, at: Array, yaw: float, *, on_road: bool = False) -> bool:
    shape = site.choose(tuple(_TRUCKS))
    paint = vary(site, site.choose(_PAINTS[:2] + STEEL))
    return site.place(
        "truck", shape, at, _TRUCKS[shape], yaw, paint, on_road=on_road, on_reserved=on_road
    )  # fmt: skip
