"""Build the mesh of a named shape; vehicles, skips, benches and lamps are defined here.

Meshes are built in metres and fitted to the unit cube, which is scaled to an object's box. The
front of an object faces +x, but a bench faces -y. The parts that take the object's own colour have
the material "paint".
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from simulate.look.freight import FREIGHT
from simulate.look.furniture import FURNITURE
from simulate.look.mesh import Mesh, MeshBuilder
from simulate.look.plants import bare_tree, broadleaf, conifer
from simulate.look.structures import STRUCTURES
from simulate.look.vessels import VESSELS
from simulate.place.world import Rgb

_RUBBER: Rgb = (0.018, 0.018, 0.019)
_TRIM: Rgb = (0.045, 0.046, 0.048)
_GLASS: Rgb = (0.025, 0.030, 0.034)
_LAMP_WHITE: Rgb = (0.75, 0.75, 0.70)
_LAMP_RED: Rgb = (0.30, 0.02, 0.02)
_WOOD: Rgb = (0.24, 0.15, 0.085)
_IRON: Rgb = (0.06, 0.06, 0.065)

# Shapes of cars. Distances from the rear end, as shares of the length: foot of the rear window,
# rear and front edge of the roof, foot of the windscreen. Then the height of the waist line as a
# share of the car's height.
_CAR_SHAPES = {
    "hatchback": (0.02, 0.10, 0.55, 0.74, 0.60),
    "saloon": (0.16, 0.28, 0.55, 0.72, 0.62),
    "estate": (0.01, 0.07, 0.57, 0.73, 0.60),
    "suv": (0.01, 0.09, 0.58, 0.73, 0.58),
}


def shape_mesh(name: str) -> Mesh:
    """Return the mesh of a shape, fitted to the unit cube.

    Raises:
        KeyError: there is no shape of that name.
    """
    kind, _, variant = name.rpartition("_")
    if kind == "broadleaf":
        return broadleaf(int(variant)).fit_to_cube()
    if kind == "bare":
        return bare_tree(int(variant)).fit_to_cube()
    if kind == "conifer":
        return conifer(int(variant)).fit_to_cube()
    if name in _CAR_SHAPES:
        return _car(*_CAR_SHAPES[name]).fit_to_cube()
    return _SHAPES[name]().fit_to_cube()


def _car(
    rear_window: float, roof_rear: float, roof_front: float, windscreen: float, waist: float
) -> Mesh:
    """Build a car of 4.5 x 1.8 x 1.5 m: a body, and a narrower cabin with glass sides."""
    length, width, height = 4.5, 1.8, 1.5
    out = MeshBuilder()
    half = 0.5 * width
    x = [length * t for t in (rear_window, roof_rear, roof_front, windscreen)]
    w, sill, nose = waist * height, 0.16, 0.48 * height
    body = [(0.05, sill), (length - 0.05, sill), (length, 0.32), (length - 0.03, nose),
            (x[3], w), (x[0], w), (0.0, 0.62 * height if rear_window < 0.1 else 0.56 * height),
            (0.0, 0.32)]  # fmt: skip
    out.prism(body, (-half, half), "paint")
    # The cabin's sides lean inwards. Its roof and pillars are painted, and the rest is glass.
    lean = 0.20
    base = [(x[0], -half + 0.06, w), (x[3], -half + 0.06, w), (x[3], half - 0.06, w),
            (x[0], half - 0.06, w)]  # fmt: skip
    roof = [(x[1], -half + lean, height), (x[2], -half + lean, height),
            (x[2], half - lean, height), (x[1], half - lean, height)]  # fmt: skip
    out.polygon(roof, "paint")
    for i in range(4):
        j = (i + 1) % 4
        out.polygon([base[i], base[j], roof[j], roof[i]], "glass", _GLASS)
    for t in (0.36, 0.64):  # door pillars
        a = x[0] + t * (x[3] - x[0])
        b = x[1] + t * (x[2] - x[1])
        for side in (-1, 1):
            foot, top = side * (half - 0.05), side * (half - lean + 0.01)
            quad = [(a - 0.05, foot, w), (a + 0.05, foot, w), (b + 0.05, top, height),
                    (b - 0.05, top, height)]  # fmt: skip
            out.polygon(quad[::-side], "paint")
    for side in (-1, 1):
        y = side * half
        for at in (0.80, 3.65):
            _wheel(out, at, y, 0.33)
        low, high = sorted((y, y - side * 0.35))
        out.box(
            (length - 0.12, low + 0.05, 0.5),
            (length + 0.005, high - 0.05, 0.64),
            "headlight",
            _LAMP_WHITE,
        )
        out.box((-0.005, low + 0.05, 0.62), (0.08, high - 0.05, 0.78), "tail_light", _LAMP_RED)
        low, high = sorted((y, y + side * 0.12))
        out.box((x[3] - 0.3, low, w - 0.05), (x[3] - 0.15, high, w + 0.1), "plain", _TRIM)
    out.box((-0.02, -0.3, 0.40), (0.02, 0.3, 0.52), "plain", (0.6, 0.6, 0.55))
    out.box((length - 0.03, -0.5, 0.25), (length + 0.01, 0.5, 0.42), "plain", _TRIM)
    return out.build()


def _wheel(out: MeshBuilder, x: float, y: float, radius: float) -> None:
    """Add a wheel on the ground at ``x``, with its outer side at ``y``."""
    turn = np.linspace(0, 2 * np.pi, 10, endpoint=False)
    ring = np.stack([x + radius * np.cos(turn), radius + radius * np.sin(turn)], -1)
    low, high = sorted((y - np.sign(y) * 0.2, y + np.sign(y) * 0.01))
    out.prism(ring, (low, high), "plain", _RUBBER)


def _van() -> Mesh:
    """Build a van of 5.6 x 2.0 x 2.5 m with ribs on its roof."""
    out = MeshBuilder()
    half = 1.0
    side = [(0.0, 0.25), (5.6, 0.25), (5.6, 0.95), (5.45, 1.15), (4.75, 1.35), (4.2, 2.3),
            (3.9, 2.45), (0.05, 2.45)]  # fmt: skip
    out.prism(side, (-half, half), "paint")
    screen = [(4.78, -0.88, 1.40), (4.78, 0.88, 1.40), (4.25, 0.82, 2.26), (4.25, -0.82, 2.26)]
    out.polygon([(x + 0.03, y, z + 0.02) for x, y, z in screen], "glass", _GLASS)
    for y in (-half, half):
        door = [(3.4, y * 1.004, 1.35), (4.6, y * 1.004, 1.35), (4.15, y * 1.004, 2.15),
                (3.4, y * 1.004, 2.15)]  # fmt: skip
        out.polygon(door if y < 0 else door[::-1], "glass", _GLASS)
        for x in (1.0, 4.5):
            _wheel(out, x, y, 0.36)
    for y in np.linspace(-0.7, 0.7, 4):  # roof ribs
        out.box((0.3, y - 0.03, 2.4), (3.6, y + 0.03, 2.475), "paint")
    return out.build()


def _lorry() -> Mesh:
    """Build a lorry: a cab and a ribbed box body."""
    out = MeshBuilder()
    out.box((0, -1.22, 1.05), (6.1, 1.22, 3.4), "paint")
    for x in np.linspace(0.0, 6.1, 8):  # ribs of the body
        out.box((x - 0.03, -1.235, 1.05), (x + 0.03, 1.235, 3.41), "plain", (0.35, 0.35, 0.35))
    out.box((0, -0.5, 0.55), (8.0, 0.5, 1.05), "plain", _TRIM)
    cab = [(6.3, 0.5), (8.4, 0.5), (8.4, 1.5), (8.15, 2.75), (6.3, 2.85)]
    out.prism(cab, (-1.18, 1.18), "plain", (0.45, 0.45, 0.46))
    out.polygon([(8.42, -1.05, 1.55), (8.42, 1.05, 1.55), (8.2, 1.0, 2.55), (8.2, -1.0, 2.55)],
                "glass", _GLASS)  # fmt: skip
    for y in (-1.19, 1.19):
        window = [(7.2, y, 1.6), (8.2, y, 1.6), (8.05, y, 2.4), (7.2, y, 2.4)]
        out.polygon(window if y < 0 else window[::-1], "glass", _GLASS)
        for x in (1.0, 2.1, 7.3):
            _wheel(out, x, y, 0.48)
    return out.build()


def _skip() -> Mesh:
    """Build an open waste skip with sloping ends, half full."""
    out = MeshBuilder()
    side = [(0.5, 0.0), (2.7, 0.0), (3.2, 1.3), (0.0, 1.3)]
    for y0, y1 in ((-0.85, -0.8), (0.8, 0.85)):
        out.prism(side, (y0, y1), "paint")
    out.prism([(0.5, 0.0), (0.55, 0.0), (0.05, 1.3), (0.0, 1.3)], (-0.8, 0.8), "paint")
    out.prism([(2.65, 0.0), (2.7, 0.0), (3.2, 1.3), (3.15, 1.3)], (-0.8, 0.8), "paint")
    out.prism(
        [(0.5, 0.0), (2.7, 0.0), (2.95, 0.8), (0.3, 0.8)], (-0.8, 0.8), "plain", (0.14, 0.11, 0.08)
    )
    return out.build()


def _bench() -> Mesh:
    out = MeshBuilder()
    for y in (-0.20, -0.03, 0.14):
        out.box((0, y, 0.42), (1.8, y + 0.14, 0.47), "plain", _WOOD)
    for z in (0.56, 0.72):
        out.box((0, 0.29, z), (1.8, 0.33, z + 0.13), "plain", _WOOD)
    for x in (0.15, 1.55):
        out.box((x, -0.22, 0), (x + 0.1, -0.15, 0.42), "plain", _IRON)
        out.box((x, 0.26, 0), (x + 0.1, 0.33, 0.82), "plain", _IRON)
    return out.build()


def _lamp() -> Mesh:
    """Build a lamp post at the -x end of its box, with its arm along +x over the road."""
    out = MeshBuilder()
    out.box((0, -0.07, 0), (0.14, 0.07, 7.0), "paint")
    out.box((0.14, -0.04, 6.9), (1.2, 0.04, 6.98), "paint")
    out.box((1.1, -0.12, 6.84), (1.7, 0.12, 6.97), "street_light", (0.5, 0.5, 0.48))
    return out.build()


_SHAPES: dict[str, Callable[[], Mesh]] = {
    "van": _van,
    "lorry": _lorry,
    "skip": _skip,
    "bench": _bench,
    "lamp": _lamp,
    **FURNITURE,
    **FREIGHT,
    **STRUCTURES,
    **VESSELS,
}
