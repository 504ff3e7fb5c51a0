"""Build residential blocks: houses on parcels, and blocks of flats."""

from __future__ import annotations

import numpy as np

from simulate.place.objects import STEEL, Local, Size, barrier, bench, building, car, tree
from simulate.place.parking import AISLE_M, BAY_M, car_park
from simulate.place.site import PAVEMENT_M, ObjectSpec, Site
from simulate.place.streets import Block, Frame
from simulate.place.styles import house_style, shed_style, slab_style


def housing(site: Site, block: Block) -> None:
    """Lay two rows of parcels back to back, each with a house, a drive and a garden."""
    depth = 0.5 * block.depth
    for side in (1, -1):
        count = max(1, round(block.length / site.rng.uniform(14.5, 19.0)))
        width = block.length / count
        for i in range(count):
            parcel = block.front(side).shift(i * width)
            _parcel(site, parcel, width, depth, back_line=side > 0, last=i == count - 1)


def _parcel(
    site: Site, at: Frame, width: float, depth: float, *, back_line: bool, last: bool
) -> None:
    rng = site.rng
    site.paint("grass", at.quad(0, width, 0, depth), float(rng.random()))
    # The drive runs along one side of the parcel, and the house takes the rest of the width.
    left = site.chance(0.5)
    front = min(width - 6.2, rng.uniform(8.5, 12.5))
    back = min(0.45 * depth, rng.uniform(7.5, 10.5))
    setback = rng.uniform(3.5, min(7.0, 0.3 * depth))
    drive = 2.5 if left else width - 2.5
    middle = (4.9 + width - 0.9) / 2 if left else (width - 4.9 + 0.9) / 2
    drive_end = setback + rng.uniform(0.3, 0.8) * back
    lane = at.quad(drive - 1.5, drive + 1.5, -PAVEMENT_M - 0.8, drive_end)
    door = middle + rng.uniform(-0.25, 0.25) * front
    walk = at.quad(door - 0.6, door + 0.6, -0.6, setback + 1.0)
    site.paint("driveway", lane, float(rng.random()))
    site.paint("path" if site.chance(0.4) else "pavement", walk, float(rng.random()))

    b = setback + 0.5 * back
    style = house_style(site, front, back)
    height = 2.8 * style.floors + 0.4 + style.roof_height_m
    building(site, "house", at, (middle, b), (front, back, height), style)
    patio = rng.uniform(2.5, 4.5)
    a0 = middle + rng.uniform(-0.4, 0.0) * front
    terrace = at.quad(a0, a0 + 4.0, setback + back - 0.5, setback + back + patio)
    site.paint("pavement", terrace, float(rng.random()))

    if site.chance(0.45):
        b = drive_end + 3.2
        outbuilding(site, at, (drive, b), (3.0, 6.0, 2.7))
    site.reserve(at.quad(drive - 1.4, drive + 1.4, -0.5, drive_end - 0.2))
    if site.chance(0.6):
        car(site, at.point(drive, 2.8), at.yaw(drive, 2.8) + np.pi / 2 * site.choose((1, -1)))
    if site.chance(0.4):
        a = 2.2 if site.chance(0.5) else width - 2.2
        outbuilding(site, at, (a, depth - 2.4), (2.6, 2.2, 2.3))

    runs = [((0.0, 0.6), (0.0, depth - 0.6))]
    if last:
        runs.append(((width, 0.6), (width, depth - 0.6)))
    if back_line:
        runs.append(((0.7, depth), (width - 0.7, depth)))
    gaps = [(drive - 1.7, drive + 1.7), (door - 0.8, door + 0.8)]
    edge = _enclose(site, at, width, runs, gaps)

    for _ in range(int(rng.integers(6, 22))):
        a, b = rng.uniform(1.5, width - 1.5), rng.uniform(setback + back + 1.5, depth - 1.2)
        tree(site, at.point(a, b), rng.uniform(0.6, 3.4), conifers=0.2)
    if site.chance(0.6):
        tree(site, at.point(rng.uniform(1, width - 1), 2.0), rng.uniform(0.9, 1.8), conifers=0.2)
    if site.chance(0.15):
        bench(site, at.point(edge + 2.0, setback + back + 1.2), at.yaw(edge, setback + back))


def _enclose(
    site: Site, at: Frame, width: float, runs: list[tuple[Local, Local]], gaps: list[Local]
) -> float:
    """Place hedges or fences along some sides of a parcel, and perhaps along its street.

    Args:
        site: site on which they are placed.
        at: frame of the parcel.
        width: width of the parcel along the street, metres.
        runs: first and last local point of each side.
        gaps: first and last metre along the street that stay open for the drive and the walk.

    Returns:
        Start of the last hedge or fence, metres along the street.
    """
    rng = site.rng
    kind, hedge = ("hedge", True) if site.chance(0.55) else ("fence", False)
    section = (0.8, rng.uniform(1.1, 1.9)) if hedge else (0.10, rng.uniform(1.0, 1.8))
    street: list[tuple[Local, Local]] = []
    if site.chance(0.45):
        start = 0.7
        for first, last in [*sorted(gaps), (width - 0.7, width)]:
            street.append(((start, 0.1), (first, 0.1)))
            start = last
    for start_at, end_at in [*runs, *street]:
        barrier(site, kind, at, start_at, end_at, section)
    return start_at[0]


def outbuilding(site: Site, at: Frame, spot: Local, size: Size) -> None:
    """Place a garage or a shed."""
    style = shed_style(site)
    building(site, "shed", at, spot, size, style)


def flats(site: Site, block: Block) -> None:
    """Place two rows of flats that face the streets, with a car park between them."""
    rng = site.rng
    site.paint("grass", block.front(1).quad(0, block.length, 0, block.depth), float(rng.random()))
    strip = 2 * BAY_M[1] + AISLE_M
    middle = 0.5 * block.depth
    for side in (1, -1):
        at = block.front(side)
        room = middle - 0.5 * strip - 2.0
        depth = min(12.0, room - 3.5)
        if depth < 6.5:
            continue
        setback = 0.5 * (room - depth) + 0.5
        count = max(1, round(block.length / rng.uniform(26, 42)))
        floors = int(rng.integers(3, 6))
        for i in range(count):
            share = block.length / count
            a, b = (i + 0.5) * share, setback + 0.5 * depth
            style = slab_style(site, floors)
            size = (share - rng.uniform(5, 9), depth, 2.9 * floors + 0.4 + style.roof_height_m)
            building(site, "slab", at, (a, b), size, style)
            walk = at.quad(a - 0.9, a + 0.9, -0.6, setback + 1.0)
            site.paint("pavement", walk, float(rng.random()))
            site.reserve(walk)
            bench(site, at.point(a + 3.0, setback - 1.2), at.yaw(a, 0))
    at = block.front(1)
    lot_start = 4.0
    length = block.length - lot_start - 4.0
    exit_ = at.quad(-PAVEMENT_M - 1.0, lot_start + 1, middle - 3, middle + 3)
    site.paint("parking", exit_, 0.5)
    car_park(site, at.shift(lot_start, middle - 0.5 * strip), length, rows=1)
    for a in (1.2, block.length - 2.0):
        b = middle + rng.uniform(3.5, 6.0)
        skip = ObjectSpec("container", "skip", (3.2, 1.7, 1.35), site.choose(STEEL))
        site.place(skip, at.point(a, b), at.yaw(a, b) + np.pi / 2)
    for _ in range(45):
        a, b = rng.uniform(2, block.length - 2), rng.uniform(1, block.depth - 1)
        tree(site, block.front(1).point(a, b), rng.uniform(1.4, 3.6))
