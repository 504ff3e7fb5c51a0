"""Build meshes of buildings: walls with bays, gable, hip and flat roofs, and roof installations.

A mesh has the frame of its building's box: the origin is the centre of the base, and x runs along
the frontage. Lengths are in metres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulate.look.mesh import Mesh, MeshBuilder
from simulate.look.textures import BAY_M, BAYS, FLOOR_M, FLOORS, ROOF_TILE_M, facade_material
from simulate.place.world import BuildingStyle, Facade, Rgb, WorldObject

_FOUNDATION_M = 1.5  # walls reach this far below the base, because the ground may slope
_CHIMNEY_M = 0.5  # part of `roof_height_m` above the ridge of a pitched house roof


def building_mesh(building: WorldObject) -> Mesh:
    """Build the mesh of a building, which fills the building's box above the ground.

    Raises:
        ValueError: the building has no style.
    """
    style = building.style
    if style is None:
        raise ValueError(f"building {building.id} has no style")
    rng = np.random.default_rng(style.detail)
    out = MeshBuilder()
    length, depth, height = building.size
    half_x, half_y = 0.5 * length, 0.5 * depth
    wall_top = height - style.roof_height_m
    house = building.shape == "house"
    ridge = height - (_CHIMNEY_M if house and style.roof != "flat" else 0.0)

    # The main body takes the whole width at the back of the box. The wing of an L extends forward
    # from the left part of the main body.
    main_depth, wing_width = style.main_depth_share * depth, style.wing_width_share * length
    split = half_y - main_depth
    main = (-half_x, half_x, split, half_y)
    bodies = [(main, ridge)]
    if style.wing_width_share < 1.0:
        wing = (-half_x, -half_x + wing_width, -half_y, split + 0.5 * (half_y - split))
        # The wing reaches under the main roof as far as the main ridge, so that no gap is seen.
        wing_ridge = wall_top + (ridge - wall_top) * min(1.0, wing_width / (half_y - split))
        bodies.append((wing, min(wing_ridge, ridge - 0.15)))
    for k, (rect, top) in enumerate(bodies):
        turned = k == 1
        _walls(out, _inset(rect, style.overhang_m), wall_top, style.facade, style.wall_rgb, rng)
        if style.roof == "flat":
            parapet = min(height, wall_top + 0.45) if k == 0 else wall_top + 0.2
            _flat_roof(out, rect, parapet, style.roof_rgb, style.wall_rgb, rng)
        elif style.roof == "hip" and not turned:
            _hip_roof(out, rect, (wall_top, top), style, rng)
        else:
            _gable_roof(out, rect, (wall_top, top), style, rng, turned=turned)
    if style.roof == "flat":
        _roof_installations(out, main, wall_top, height, building.shape, rng)
    elif house:
        _chimney(out, main, wall_top, ridge, height, rng)
    if building.shape in ("house", "slab", "hall") and style.roof != "flat":
        _skylights(out, main, wall_top, ridge, style.roof == "hip", rng)
    return out.build()


Rect = tuple[float, float, float, float]  # x0, x1, y0, y1


def _inset(rect: Rect, by: float) -> Rect:
    x0, x1, y0, y1 = rect
    return x0 + by, x1 - by, y0 + by, y1 - by


def _outline(rect: Rect, z: float) -> NDArray[np.float64]:
    x0, x1, y0, y1 = rect
    return np.array([(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)])


def _walls(
    out: MeshBuilder, rect: Rect, top: float, facade: Facade, tint: Rgb, rng: np.random.Generator
) -> None:
    """Add four walls. The facade image is scaled so that every wall shows whole bays."""
    low, high = _outline(rect, -_FOUNDATION_M), _outline(rect, top)
    v1 = top / (FLOORS * FLOOR_M)
    material = facade_material(facade)
    for i in range(4):
        j = (i + 1) % 4
        bays = max(1, round(float(np.linalg.norm(low[j] - low[i])) / BAY_M))
        u0 = int(rng.integers(BAYS)) / BAYS
        u1 = u0 + bays / BAYS
        # Below the base the image would repeat its top floor, so its lowest row is stretched
        # instead.
        foot_i, foot_j = low[i] * [1, 1, 0], low[j] * [1, 1, 0]
        uv = [(u0, 0.001), (u1, 0.001), (u1, v1), (u0, v1)]
        out.polygon([foot_i, foot_j, high[j], high[i]], material, tint, uv)
        flat = [(u0, 0.001)] * 4
        out.polygon([low[i], low[j], foot_j, foot_i], material, tint, flat)


def _slope(
    out: MeshBuilder,
    points: NDArray[np.float64],
    roofing: str,
    tint: Rgb,
    rng: np.random.Generator,
) -> None:
    """Add a roof plane with corners (K, 3), of which the first two are the ends of the eaves.

    The texture runs up the slope.
    """
    along = points[1] - points[0]
    along /= np.linalg.norm(along)
    normal = np.cross(along, points[2] - points[0])
    up = np.cross(normal / np.linalg.norm(normal), along)
    offset = rng.uniform(0, 1, 2)
    local = points - points[0]
    uv = np.stack([local @ along, local @ up], -1) / ROOF_TILE_M + offset
    out.polygon(points, f"roof_{roofing}", tint, uv)


def _gable_roof(
    out: MeshBuilder,
    rect: Rect,
    heights: tuple[float, float],
    style: BuildingStyle,
    rng: np.random.Generator,
    *,
    turned: bool,
) -> None:
    """Add two slopes and two gables. The ridge runs along x, or along y when ``turned``.

    ``heights`` are the heights of the walls' top and of the ridge. The slopes pass through both
    lines, so that the eaves of a roof with an overhang are below the walls' top.
    """
    walls = _inset(rect, style.overhang_m)
    wall_top, ridge = heights

    def corner(a: float, b: float, z: float) -> tuple[float, float, float]:
        return (-b, a, z) if turned else (a, b, z)

    x0, x1, y0, y1 = (rect[2], rect[3], -rect[1], -rect[0]) if turned else rect
    w0, w1, d0, d1 = (walls[2], walls[3], -walls[1], -walls[0]) if turned else walls
    m = 0.5 * (y0 + y1)
    eaves = wall_top - (ridge - wall_top) * (d0 - y0) / max(m - d0, 0.1)
    for a, b, y in ((x0, x1, y0), (x1, x0, y1)):
        ends = ((a, y, eaves), (b, y, eaves), (b, m, ridge), (a, m, ridge))
        corners = [corner(*end) for end in ends]
        _slope(out, np.array(corners), style.roofing, style.roof_rgb, rng)
        under = [(p[0], p[1], p[2] - 0.12) for p in reversed(corners)]
        out.polygon(under, "plain", (0.30, 0.27, 0.24))
    for x, order in ((w0, -1), (w1, 1)):
        gable = [corner(x, d0, wall_top), corner(x, d1, wall_top), corner(x, m, ridge - 0.05)]
        shade: Rgb = tuple(0.8 * c for c in style.wall_rgb)  # type: ignore[assignment]
        out.polygon(gable[::order], "plain", shade)


def _hip_roof(
    out: MeshBuilder,
    rect: Rect,
    heights: tuple[float, float],
    style: BuildingStyle,
    rng: np.random.Generator,
) -> None:
    """Add four slopes.

    ``heights`` are the heights of the eaves, which are level with the walls' top, and of the ridge.
    """
    x0, x1, y0, y1 = rect
    eaves, ridge = heights
    m = 0.5 * (y0 + y1)
    run = min(0.5 * (y1 - y0), 0.48 * (x1 - x0))
    a, b = (x0 + run, m, ridge), (x1 - run, m, ridge)
    sw, se, ne, nw = (x0, y0, eaves), (x1, y0, eaves), (x1, y1, eaves), (x0, y1, eaves)
    for plane in ([sw, se, b, a], [se, ne, b], [ne, nw, a, b], [nw, sw, a]):
        _slope(out, np.array(plane), style.roofing, style.roof_rgb, rng)
    out.polygon([nw, ne, se, sw], "plain", (0.30, 0.27, 0.24))


def _flat_roof(
    out: MeshBuilder, rect: Rect, top: float, tint: Rgb, wall_rgb: Rgb, rng: np.random.Generator
) -> None:
    """Add a flat roof inside a low parapet."""
    x0, x1, y0, y1 = rect
    _slope(out, _outline(rect, top - 0.2), "flat", tint, rng)
    t = 0.22
    rim: Rgb = tuple(0.7 * c + 0.08 for c in wall_rgb)  # type: ignore[assignment]
    low = top - 0.55
    out.box((x0, y0, low), (x1, y0 + t, top), "plain", rim)
    out.box((x0, y1 - t, low), (x1, y1, top), "plain", rim)
    out.box((x0, y0 + t, low), (x0 + t, y1 - t, top), "plain", rim)
    out.box((x1 - t, y0 + t, low), (x1, y1 - t, top), "plain", rim)


def _roof_installations(
    out: MeshBuilder, rect: Rect, wall_top: float, top: float, shape: str, rng: np.random.Generator
) -> None:
    """Add stair heads, ventilators, hatches and solar panels on a flat roof, up to ``top``."""
    # Heights of installations are above this level, 0.15 m above the roof's surface. Boxes begin at
    # the top of the walls, below the surface.
    base = wall_top + 0.4
    x0, x1, y0, y1 = _inset(rect, 1.0)
    if shape == "shed":
        return
    area = (x1 - x0) * (y1 - y0)
    if top - base > 1.0:  # the highest installation reaches the top of the box
        size = (2.2, 2.2) if shape == "hall" else (min(4.0, x1 - x0), min(3.0, y1 - y0))
        x = rng.uniform(x0, x1 - size[0])
        y = rng.uniform(y0, max(y0 + 0.1, y1 - size[1]))
        out.box((x, y, base - 0.4), (x + size[0], y + size[1], top), "plain", (0.34, 0.33, 0.32))
    for _ in range(int(area / 28) + int(rng.integers(0, 4))):
        x, y = rng.uniform(x0, x1), rng.uniform(y0, y1)
        w, d, h = rng.uniform(0.5, 1.8, 3) * (1, 1, 0.5)
        shade = rng.uniform(0.12, 0.5)
        out.box(
            (x, y, base - 0.4),
            (min(x + w, x1 + 0.7), min(y + d, y1 + 0.7), min(base + h, top)),
            "plain",
            (shade, shade, shade * rng.uniform(0.95, 1.1)),
        )
    if rng.random() < 0.5:
        columns = int((x1 - x0) * rng.uniform(0.2, 0.6) / 1.3)
        y = rng.uniform(y0, 0.5 * (y0 + y1))
        x = rng.uniform(x0, 0.4 * x1 + 0.6 * x0)
        for i in range(columns):
            for j in range(int(rng.integers(1, 3))):
                a, b, high = x + 1.3 * i, y + 2.2 * j, min(base + 0.45, top)
                quad = [(a, b, base), (a + 1.15, b, base), (a + 1.15, b + 1.5, high),
                        (a, b + 1.5, high)]  # fmt: skip
                if a + 1.2 < x1 and b + 1.6 < y1:
                    out.polygon(quad, "glass", (0.02, 0.03, 0.07))


def _chimney(
    out: MeshBuilder,
    rect: Rect,
    wall_top: float,
    ridge: float,
    top: float,
    rng: np.random.Generator,
) -> None:
    """Add a chimney on the ridge up to the top of the box, and sometimes a second, lower one."""
    x0, x1, y0, y1 = rect
    m = 0.5 * (y0 + y1)
    brick = (0.24, 0.11, 0.08) if rng.random() < 0.7 else (0.42, 0.40, 0.37)
    half = 0.5 * (x1 - x0)
    x = 0.5 * (x0 + x1) + rng.uniform(-0.45, 0.45) * half
    out.box((x - 0.35, m - 0.35, wall_top), (x + 0.35, m + 0.35, top), "plain", brick)
    out.box((x - 0.18, m - 0.18, top - 0.1), (x + 0.18, m + 0.18, top), "plain", (0.03, 0.03, 0.03))
    if rng.random() < 0.4:
        x, y = x0 + rng.uniform(0.3, 0.7) * (x1 - x0), m + rng.uniform(0.15, 0.3) * (y1 - y0)
        out.box(
            (x - 0.15, y - 0.15, wall_top), (x + 0.15, y + 0.15, ridge - 0.2), "plain", (0.3,) * 3
        )


def _skylights(
    out: MeshBuilder, rect: Rect, wall_top: float, ridge: float, hip: bool, rng: np.random.Generator
) -> None:
    """Add skylights or solar panels at least 6 cm above the slopes.

    They lie 6 cm above the plane from the ridge to the edge of the roof at the height of the walls'
    top. For a hip roof, this plane is the slope. The slope of a gable roof with an overhang is
    lower.
    """
    x0, x1, y0, y1 = rect
    m, half = 0.5 * (y0 + y1), 0.5 * (y1 - y0)
    rise = (ridge - wall_top) / half
    lift = np.array([0.0, -rise, 1.0]) / np.hypot(rise, 1.0) * 0.06

    def panel(xa: float, xb: float, s0: float, s1: float, side: int, tint: Rgb) -> None:
        """Add a panel from ``xa`` to ``xb`` between the shares ``s0`` < ``s1`` of the slope."""
        quad = [
            (x, m + side * half * (1 - s), wall_top + s * (ridge - wall_top)) for x, s in
            ((xa, s0), (xb, s0), (xb, s1), (xa, s1))
        ]  # fmt: skip
        points = np.array(quad) + lift * (1, -side, 1)
        out.polygon(points if side < 0 else points[::-1], "glass", tint)

    reach = 0.25 if hip else 0.42
    middle, span = 0.5 * (x0 + x1), reach * (x1 - x0)
    if rng.random() < 0.35:  # an array of solar panels
        side = int(rng.choice([-1, 1]))
        a = middle - span * rng.uniform(0.3, 0.9)
        for i in range(int(rng.integers(3, 8))):
            if a + 1.15 * i + 1.05 < middle + span:
                for s0, s1 in ((0.22, 0.48), (0.50, 0.76)):
                    panel(a + 1.15 * i, a + 1.15 * i + 1.05, s0, s1, side, (0.02, 0.025, 0.06))
    else:
        for _ in range(int(rng.integers(0, 5))):
            x = middle + rng.uniform(-1, 1) * (span - 0.5)
            s, side = rng.uniform(0.25, 0.55), int(rng.choice([-1, 1]))
            panel(x - 0.45, x + 0.45, s, s + 0.22, side, (0.07, 0.09, 0.11))
