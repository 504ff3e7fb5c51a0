"""A town: a warped grid of streets whose blocks are housing, flats, trade, parks and fields."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from scene.errors import InputError
from simulate import ground
from simulate.site import PAVEMENT_M, Site
from simulate.streets import Block, Frame, lay_streets
from simulate.world import (
    BuildingStyle,
    Heightfield,
    Rgb,
    World,
    polyline_length,
    polyline_points,
    ribbon,
)

Array = NDArray[np.float64]
Size = tuple[float, float, float]  # length, width, height in metres

MIN_AREA_M, MAX_AREA_M = 100.0, 800.0
_BLOCK_M = 80.0  # typical distance between streets
_BAY_M = (2.6, 5.0)  # a parking bay
_AISLE_M = 6.0  # between two rows of bays

# Linear albedo.
_WALLS: tuple[Rgb, ...] = (
    (0.58, 0.56, 0.51),
    (0.52, 0.46, 0.35),
    (0.28, 0.125, 0.085),
    (0.40, 0.39, 0.38),
    (0.50, 0.38, 0.24),
    (0.34, 0.21, 0.145),
    (0.48, 0.50, 0.50),
)
_TILES: tuple[Rgb, ...] = (
    (0.235, 0.105, 0.070),
    (0.19, 0.088, 0.062),
    (0.150, 0.090, 0.070),
    (0.095, 0.090, 0.092),
    (0.066, 0.068, 0.074),
    (0.20, 0.135, 0.10),
)
_FLAT_ROOFS: tuple[Rgb, ...] = ((0.28, 0.27, 0.26), (0.16, 0.16, 0.17), (0.34, 0.32, 0.29))
_METAL_ROOFS: tuple[Rgb, ...] = (
    (0.34, 0.36, 0.38),
    (0.22, 0.27, 0.31),
    (0.31, 0.20, 0.16),
    (0.20, 0.26, 0.21),
)
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
_STEEL: tuple[Rgb, ...] = (
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
_LAMP_M: Size = (1.7, 0.24, 7.0)
_CONTAINER_M: dict[str, Size] = {
    "container": (6.06, 2.44, 2.59),
    "long_container": (12.19, 2.44, 2.59),
}


def build_town(seed: int, area_m: float) -> World:
    """A town of `area_m` metres a side; the same seed and area always give the same town.

    Raises InputError when `area_m` is outside 100..800 m or the seed is negative.
    """
    if not MIN_AREA_M <= area_m <= MAX_AREA_M:
        raise InputError(
            f"area must be {MIN_AREA_M:.0f} to {MAX_AREA_M:.0f} m a side, got {area_m:g}"
        )
    if seed < 0:
        raise InputError(f"seed must not be negative, got {seed}")
    rng = np.random.default_rng([seed, 0])
    site = Site(area_m, _relief(area_m, rng), rng)
    blocks = lay_streets(site, area_m / max(2, round(area_m / _BLOCK_M)))

    # The four blocks nearest the middle hold one of each use, so every town has every class.
    uses = [_housing, _flats, _trade, _park]
    first = [uses[i] for i in rng.permutation(4)]
    for i, block in enumerate(blocks):
        if i < 4:
            first[i](site, block)
        elif site.chance(0.12):
            _field(site, block)
        else:
            weights = (0.60, 0.14, 0.13, 0.13)
            uses[int(rng.choice(4, p=weights))](site, block)
    _street_furniture(site)
    _traffic(site)
    return World(
        seed=seed,
        area_m=float(area_m),
        terrain=site.terrain,
        roads=site.roads,
        ground=ground.paint(area_m, site.regions, site.markings),
        objects=tuple(site.objects),
    )


def _relief(area_m: float, rng: np.random.Generator) -> Heightfield:
    """Rolling ground: a few long waves, a few metres high, slopes of some per cent."""
    n = int(np.ceil(area_m / 2.0)) + 1
    axis = np.linspace(-0.5 * area_m, 0.5 * area_m, n)
    z = np.zeros((n, n))
    for length in rng.uniform(90.0, 330.0, 9):
        heading, phase = rng.uniform(0, 2 * np.pi, 2)
        k = 2 * np.pi / length
        wave = k * (np.cos(heading) * axis[None] + np.sin(heading) * axis[:, None]) + phase
        z += 0.0045 * length * np.sin(wave)
    return Heightfield(z, float(axis[1] - axis[0]))


# --- housing -------------------------------------------------------------------------------


def _housing(site: Site, block: Block) -> None:
    """Two rows of parcels back to back, each with a house, a drive and a garden."""
    depth = 0.5 * block.depth
    for side in (1, -1):
        count = max(1, round(block.length / site.rng.uniform(14.5, 19.0)))
        width = block.length / count
        for i in range(count):
            parcel = block.front(side).shifted(i * width)
            _parcel(site, parcel, width, depth, back_line=side > 0, last=i == count - 1)


def _parcel(
    site: Site, at: Frame, width: float, depth: float, *, back_line: bool, last: bool
) -> None:
    rng = site.rng
    site.paint("grass", at.quad(0, width, 0, depth), float(rng.random()))
    # The drive runs along one side line, the house takes the rest of the width.
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
    style = _house_style(site, front, back)
    height = 2.8 * style.floors + 0.4 + style.roof_height_m
    _building(site, "house", at, middle, b, (front, back, height), style)
    patio = rng.uniform(2.5, 4.5)
    a0 = middle + rng.uniform(-0.4, 0.0) * front
    terrace = at.quad(a0, a0 + 4.0, setback + back - 0.5, setback + back + patio)
    site.paint("pavement", terrace, float(rng.random()))

    if site.chance(0.45):
        b = drive_end + 3.2
        _outbuilding(site, at, drive, b, (3.0, 6.0, 2.7))
    site.reserve(at.quad(drive - 1.4, drive + 1.4, -0.5, drive_end - 0.2))
    if site.chance(0.6):
        _car(site, at.point(drive, 2.8), at.yaw(drive, 2.8) + np.pi / 2 * site.choose((1, -1)))
    if site.chance(0.4):
        a = 2.2 if site.chance(0.5) else width - 2.2
        _outbuilding(site, at, a, depth - 2.4, (2.6, 2.2, 2.3))

    kind, hedge = ("hedge", True) if site.chance(0.55) else ("fence", False)
    thick, high = (0.8, rng.uniform(1.1, 1.9)) if hedge else (0.10, rng.uniform(1.0, 1.8))
    runs = [((0.0, 0.6), (0.0, depth - 0.6))]
    if last:
        runs.append(((width, 0.6), (width, depth - 0.6)))
    if back_line:
        runs.append(((0.7, depth), (width - 0.7, depth)))
    if site.chance(0.45):  # along the street, open where the drive and the walk pass
        open_at = sorted([(drive - 1.7, drive + 1.7), (door - 0.8, door + 0.8)])
        start = 0.7
        for gap in [*open_at, (width - 0.7, width)]:
            runs.append(((start, 0.1), (gap[0], 0.1)))
            start = gap[1]
    for (a0, b0), (a1, b1) in runs:
        _barrier(site, kind, at, (a0, b0), (a1, b1), thick, high)

    for _ in range(int(rng.integers(6, 22))):
        a, b = rng.uniform(1.5, width - 1.5), rng.uniform(setback + back + 1.5, depth - 1.2)
        _tree(site, at.point(a, b), rng.uniform(0.6, 3.4), conifers=0.2)
    if site.chance(0.6):
        _tree(site, at.point(rng.uniform(1, width - 1), 2.0), rng.uniform(0.9, 1.8), conifers=0.2)
    if site.chance(0.15):
        _bench(site, at.point(a0 + 2.0, setback + back + 1.2), at.yaw(a0, setback + back))


def _house_style(site: Site, front: float, back: float) -> BuildingStyle:
    rng = site.rng
    floors = 1 if site.chance(0.3) else 2
    roof = str(rng.choice(["gable", "hip", "flat"], p=[0.6, 0.28, 0.12]))
    pitch = rng.uniform(0.55, 0.95)
    flat = roof == "flat"
    l_shaped = site.chance(0.45) and min(front, back) > 8.0
    main = (rng.uniform(0.60, 0.72), rng.uniform(0.42, 0.6)) if l_shaped else (1.0, 1.0)
    return BuildingStyle(
        floors=floors,
        roof=roof,
        roof_height_m=0.45 if flat else 0.5 * pitch * back * main[0] + 0.5,
        eaves_m=0.05 if flat else 0.45,
        facade=int(rng.integers(4)),
        roofing="flat" if flat else str(rng.choice(["tile", "slate"], p=[0.65, 0.35])),
        wall_rgb=_vary(site, site.choose(_WALLS)),
        roof_rgb=_vary(site, site.choose(_FLAT_ROOFS if flat else _TILES)),
        wing=main,
        detail=int(rng.integers(2**31)),
    )


def _outbuilding(site: Site, at: Frame, a: float, b: float, size: Size) -> None:
    """A garage or a shed: a small plain building."""
    gabled = site.chance(0.5)
    style = BuildingStyle(
        floors=1,
        roof="gable" if gabled else "flat",
        roof_height_m=0.7 if gabled else 0.25,
        eaves_m=0.1 if gabled else 0.03,
        facade=7,
        roofing="tile" if gabled else "flat",
        wall_rgb=_vary(site, site.choose(_WALLS)),
        roof_rgb=_vary(site, site.choose(_TILES if gabled else _FLAT_ROOFS)),
        wing=(1.0, 1.0),
        detail=int(site.rng.integers(2**31)),
    )
    _building(site, "shed", at, a, b, size, style)


# --- flats, trade ----------------------------------------------------------------------------


def _flats(site: Site, block: Block) -> None:
    """Two rows of slab blocks facing the streets, a car park between them."""
    rng = site.rng
    site.paint("grass", block.front(1).quad(0, block.length, 0, block.depth), float(rng.random()))
    strip = 2 * _BAY_M[1] + _AISLE_M
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
            style = _slab_style(site, floors)
            size = (share - rng.uniform(5, 9), depth, 2.9 * floors + 0.4 + style.roof_height_m)
            _building(site, "slab", at, a, b, size, style)
            walk = at.quad(a - 0.9, a + 0.9, -0.6, setback + 1.0)
            site.paint("pavement", walk, float(rng.random()))
            site.reserve(walk)
            _bench(site, at.point(a + 3.0, setback - 1.2), at.yaw(a, 0))
    at = block.front(1)
    lot_start = 4.0
    length = block.length - lot_start - 4.0
    exit_ = at.quad(-PAVEMENT_M - 1.0, lot_start + 1, middle - 3, middle + 3)
    site.paint("parking", exit_, 0.5)
    _car_park(site, at.shifted(lot_start, middle - 0.5 * strip), length, rows=1)
    for a in (1.2, block.length - 2.0):
        b = middle + rng.uniform(3.5, 6.0)
        site.place(
            "container", "skip", at.point(a, b), (3.2, 1.7, 1.35), at.yaw(a, b) + np.pi / 2,
            site.choose(_STEEL),
        )  # fmt: skip
    for _ in range(45):
        a, b = rng.uniform(2, block.length - 2), rng.uniform(1, block.depth - 1)
        _tree(site, block.front(1).point(a, b), rng.uniform(1.4, 3.6))


def _slab_style(site: Site, floors: int) -> BuildingStyle:
    rng = site.rng
    flat = site.chance(0.65)
    return BuildingStyle(
        floors=floors,
        roof="flat" if flat else "hip",
        roof_height_m=2.3 if flat else 3.2,  # a flat roof carries a stair head
        eaves_m=0.05 if flat else 0.5,
        facade=4 + int(rng.integers(2)),
        roofing="flat" if flat else "tile",
        wall_rgb=_vary(site, site.choose(_WALLS)),
        roof_rgb=_vary(site, site.choose(_FLAT_ROOFS if flat else _TILES)),
        wing=(1.0, 1.0),
        detail=int(rng.integers(2**31)),
    )


def _trade(site: Site, block: Block) -> None:
    """A hall or two, a car park before them, containers and lorries beside them."""
    rng = site.rng
    at = block.front(int(rng.choice([1, -1])))
    length, depth = block.length, block.depth
    site.paint("parking", at.quad(0, length, 0, depth), float(rng.random()))
    site.paint("parking", at.quad(0.35 * length, 0.35 * length + 7, -PAVEMENT_M - 1, 1), 0.4)
    rows = 2 if depth > 66 else 1
    lot = rows * (2 * _BAY_M[1] + _AISLE_M)
    _car_park(site, at.shifted(2.0, 2.5), 0.86 * length, rows)

    b0, b1 = lot + 5.0, depth - 2.0
    count = 2 if length > 52 and site.chance(0.5) else 1
    hall_end = 0.66 * length
    for i in range(count):
        share = hall_end / count
        style = _hall_style(site)
        a, b = 1.5 + (i + 0.5) * share, 0.5 * (b0 + b1)
        height = rng.uniform(5.5, 8.0) + style.roof_height_m
        size = (share - 3.0, min(b1 - b0, rng.uniform(18.0, 34.0)), height)
        _building(site, "hall", at, a, b, size, style)

    # The yard: rows of containers, then lorries wherever room is left.
    yard0, yard1 = hall_end + 3.0, length - 1.0
    for b in np.arange(b1 - 1.5, b0 + 1.5, -2.9):
        shape = "long_container" if yard1 - yard0 > 13.5 and site.chance(0.4) else "container"
        size = _CONTAINER_M[shape]
        a = yard0 + 0.5 * size[0]
        while a + 0.5 * size[0] < yard1:
            if site.chance(0.55):
                yaw = at.yaw(a, b) + rng.normal(0, 0.015)
                site.place("container", shape, at.point(a, b), size, yaw, _steel(site))
            a += size[0] + 0.6
    for _ in range(12):
        a, b = rng.uniform(yard0, yard1), rng.uniform(lot + 3.5, b1)
        _truck(site, at.point(a, b), at.yaw(a, b) + rng.choice([0.0, np.pi / 2]))
    for a in np.arange(3.0, length, 9.0):
        _tree(site, at.point(a, 1.2), rng.uniform(0.9, 1.6))


def _hall_style(site: Site) -> BuildingStyle:
    rng = site.rng
    flat = site.chance(0.45)
    return BuildingStyle(
        floors=2,
        roof="flat" if flat else "gable",
        roof_height_m=1.6 if flat else 2.2,
        eaves_m=0.1,
        facade=6,
        roofing="flat" if flat else "metal",
        wall_rgb=_vary(site, site.choose(_METAL_ROOFS + _WALLS[:2])),
        roof_rgb=_vary(site, site.choose(_FLAT_ROOFS if flat else _METAL_ROOFS)),
        wing=(1.0, 1.0),
        detail=int(rng.integers(2**31)),
    )


def _car_park(site: Site, at: Frame, length: float, rows: int) -> None:
    """`rows` aisles with marked bays on both sides, about half of them taken."""
    rng = site.rng
    wide, deep = _BAY_M
    count = int((length - 1.0) / wide)
    pitch = 2 * deep + _AISLE_M
    site.paint("parking", at.quad(0, length, -0.5, rows * pitch + 0.5), float(rng.random()))
    taken = rng.uniform(0.3, 0.75)
    for row in range(rows):
        for b0, b1 in ((0.0, deep), (deep + _AISLE_M, pitch)):
            b0, b1 = b0 + row * pitch, b1 + row * pitch
            for i in range(count + 1):
                site.mark(at.point([0.5 + i * wide] * 2, [b0, b1]))
            for i in range(count):
                if not site.chance(taken):
                    continue
                a, b = 0.5 + (i + 0.5) * wide, 0.5 * (b0 + b1) + rng.normal(0, 0.15)
                yaw = at.yaw(a, b) + np.pi / 2 * site.choose((1, -1)) + rng.normal(0, 0.02)
                (_car if site.chance(0.93) else _van)(site, at.point(a, b), yaw)
    site.reserve(at.quad(0, length, 0, rows * pitch))


# --- parks and fields ------------------------------------------------------------------------


def _park(site: Site, block: Block) -> None:
    """Grass, two winding paths with benches, perhaps a pitch, and many trees."""
    rng = site.rng
    at = block.front(1)
    length, depth = block.length, block.depth
    site.paint("grass", at.quad(0, length, 0, depth), float(rng.random()))
    t = np.linspace(0, 1, 25)
    for (a0, b0), (a1, b1) in (
        ((0.15 * length, -1.5), (0.85 * length, depth + 1.5)),
        ((-1.5, rng.uniform(0.5, 0.9) * depth), (length + 1.5, rng.uniform(0.1, 0.5) * depth)),
    ):
        bend = rng.uniform(-5, 5) * np.sin(np.pi * t) + rng.uniform(-3, 3) * np.sin(2 * np.pi * t)
        path = at.point(a0 + t * (a1 - a0) + bend, b0 + t * (b1 - b0) + bend)
        site.paint("path", ribbon(path, 2.4), float(rng.random()))
        for p, q in pairwise(path):
            site.reserve(ribbon(np.stack([p, q]), 2.6))
        for s in np.arange(rng.uniform(4, 9), polyline_length(path), 13.0):
            (p,), (along,) = polyline_points(path, s)
            side = site.choose((1.0, -1.0))
            yaw = float(np.arctan2(along[1], along[0])) + (0 if side > 0 else np.pi)
            _bench(site, p + side * 1.9 * np.array([-along[1], along[0]]), yaw)
    for _ in range(12):  # a pitch, if the paths leave room for one
        share = rng.uniform(0.7, 1.0)
        half = 13.0 * share, 8.0 * share
        a, b = rng.uniform(half[0], length - half[0]), rng.uniform(half[1], depth - half[1])
        pitch = at.quad(a - half[0], a + half[0], b - half[1], b + half[1])
        if site.free(at.point(a, b), (2 * half[0] + 3, 2 * half[1] + 3), at.yaw(a, b)):
            site.paint("grass", pitch, 0.9)
            site.reserve(pitch)
            site.mark(np.vstack([pitch, pitch[:1]]))
            site.mark(at.point([a, a], [b - half[1], b + half[1]]))
            break
    for _ in range(int(0.09 * length * depth)):
        a, b = rng.uniform(0, length), rng.uniform(0, depth)
        _tree(site, at.point(a, b), rng.uniform(1.6, 5.0), conifers=0.25)


def _field(site: Site, block: Block) -> None:
    """Crops, hedged on two sides, with a line of trees."""
    rng = site.rng
    at = block.front(int(rng.choice([1, -1])))
    length, depth = block.length, block.depth
    split = rng.uniform(0.35, 0.65) * length
    site.paint("field", at.quad(1, split, 1, depth - 1), float(rng.random()))
    site.paint("field", at.quad(split, length - 1, 1, depth - 1), float(rng.random()))
    for a0 in np.arange(0.5, length - 12.0, 11.0):
        _barrier(site, "hedge", at, (a0, 0.5), (a0 + 10.0, 0.5), 1.2, rng.uniform(1.4, 2.2))
    for b in np.arange(4.0, depth - 3.0, 7.0):
        _tree(site, at.point(split, b), rng.uniform(1.8, 3.4))


# --- things ----------------------------------------------------------------------------------


def _vary(site: Site, rgb: Rgb) -> Rgb:
    """The colour, a little lighter or darker and a little warmer or colder."""
    value = site.rng.uniform(0.82, 1.15)
    warm = site.rng.uniform(0.95, 1.05)
    return (rgb[0] * value * warm, rgb[1] * value, rgb[2] * value / warm)


def _steel(site: Site) -> Rgb:
    return _vary(site, site.choose(_STEEL))


def _building(
    site: Site, shape: str, at: Frame, a: float, b: float, size: Size, style: BuildingStyle
) -> bool:
    """A building facing the street of its frame, smaller when the warp leaves it less room."""
    for share in (1.0, 0.9, 0.8, 0.7):
        fitted = (size[0] * share, size[1] * share, size[2])
        if site.place("building", shape, at.point(a, b), fitted, at.yaw(a, b), style=style):
            return True
    return False


def _tree(site: Site, at: Array, radius: float, conifers: float = 0.12) -> bool:
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


def _bench(site: Site, at: Array, yaw: float) -> bool:
    return site.place("bench", "bench", at, _BENCH_M, yaw, (0.20, 0.12, 0.07), gap_m=0.05)


def _barrier(
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
    colour = _vary(site, (1.0, 1.0, 1.0) if kind == "hedge" else (0.22, 0.16, 0.11))
    site.place(kind, kind, 0.5 * (p + q), (length, thick, high), yaw, colour, gap_m=0.02)


def _car(site: Site, at: Array, yaw: float, gap_m: float = 0.15) -> bool:
    shape = site.choose(tuple(_CARS))
    paint = _vary(site, site.choose(_PAINTS))
    return site.place(
        "car", shape, at, _CARS[shape], yaw, paint, on_road=True, on_reserved=True, gap_m=gap_m
    )  # fmt: skip


def _van(site: Site, at: Array, yaw: float) -> bool:
    paint = _vary(site, site.choose(_PAINTS[:4]))
    return site.place(
        "truck", "van", at, _TRUCKS["van"], yaw, paint, on_road=True, on_reserved=True
    )  # fmt: skip


def _truck(site: Site, at: Array, yaw: float, *, on_road: bool = False) -> bool:
    shape = site.choose(tuple(_TRUCKS))
    paint = _vary(site, site.choose(_PAINTS[:2] + _STEEL))
    return site.place(
        "truck", shape, at, _TRUCKS[shape], yaw, paint, on_road=on_road, on_reserved=on_road
    )  # fmt: skip


def _street_furniture(site: Site) -> None:
    """Lamps along every road, their arms over the kerb."""
    for road in site.roads:
        side = site.choose((1.0, -1.0))
        for s in np.arange(site.rng.uniform(5, 20), polyline_length(road.line), 27.0):
            (p,), (along,) = polyline_points(road.line, s)
            across = side * np.array([-along[1], along[0]])
            yaw = float(np.arctan2(-across[1], -across[0]))
            at = p + (0.5 * road.width_m + 0.2) * across
            if _off_junction(site, at, 1.5):
                site.place("lamp", "lamp", at, _LAMP_M, yaw, (0.25, 0.26, 0.27), on_road=True)


def _traffic(site: Site) -> None:
    """Vehicles driving on the right of every road, and parked along the side streets."""
    rng = site.rng
    for road in site.roads:
        length = polyline_length(road.line)
        for direction in (1.0, -1.0):
            s = rng.uniform(0, 40)
            while s < length:
                (p,), (along,) = polyline_points(road.line, s)
                along = direction * along
                right = np.array([along[1], -along[0]])
                at = p + (0.25 * road.width_m + rng.normal(0, 0.1)) * right
                yaw = float(np.arctan2(along[1], along[0]))
                if _off_junction(site, at, 6.0):
                    if site.chance(0.85):
                        _car(site, at, yaw, gap_m=0.5)
                    else:
                        _truck(site, at, yaw, on_road=True)
                s += rng.uniform(14, 75)
        if road.main:
            continue
        side = site.choose((1.0, -1.0))
        for s in np.arange(6.0, length, 6.4):
            (p,), (along,) = polyline_points(road.line, s)
            at = p + side * (0.5 * road.width_m - 1.1) * np.array([-along[1], along[0]])
            if site.chance(0.28) and _off_junction(site, at, 9.0):
                _car(
                    site,
                    at,
                    float(np.arctan2(along[1], along[0])) + site.choose((0.0, np.pi)),
                    gap_m=0.5,
                )


def _off_junction(site: Site, at: Array, clear_m: float) -> bool:
    """Whether only one road comes within `clear_m` of `at` (2,)."""
    return len(site.roads_within(at[None], clear_m)) <= 1
