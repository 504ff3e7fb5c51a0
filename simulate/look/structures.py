"""Build meshes of solar panels, cabinets and graves, in metres.

The parts that take the object's own colour have the material "paint".
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from simulate.look.mesh import Mesh, MeshBuilder
from simulate.place.world import Rgb

_FRAME: Rgb = (0.42, 0.43, 0.44)
_STEEL: Rgb = (0.30, 0.30, 0.31)
_EARTH: Rgb = (0.055, 0.040, 0.028)
_GREEN: Rgb = (0.030, 0.055, 0.018)


def _panel(columns: int, rows: int) -> Mesh:
    """Build a table of solar panels of 12 x 4 x 2.6 m on posts, which faces -y.

    ``columns`` and ``rows`` are the numbers of its modules.
    """
    out = MeshBuilder()
    length, depth, low, high = 12.0, 4.0, 0.8, 2.59

    def at(u: float, v: float, lift: float) -> tuple[float, float, float]:
        return length * (u - 0.5), depth * (v - 0.5), low + v * (high - low) + lift

    face = [at(0, 0, 0), at(1, 0, 0), at(1, 1, 0), at(0, 1, 0)]
    out.polygon(face, "plain", _FRAME)
    out.polygon([(x, y, z - 0.04) for x, y, z in reversed(face)], "plain", (0.5, 0.5, 0.5))
    edge_u, edge_v = 0.022 / (length / columns), 0.022 / (depth / rows)
    for i in range(columns):
        for j in range(rows):
            u0, u1 = (i + edge_u) / columns, (i + 1 - edge_u) / columns
            v0, v1 = (j + edge_v) / rows, (j + 1 - edge_v) / rows
            cells = [at(u0, v0, 0.01), at(u1, v0, 0.01), at(u1, v1, 0.01), at(u0, v1, 0.01)]
            out.polygon(cells, "paint")
    for u in np.linspace(0.08, 0.92, 5):
        for v in (0.2, 0.8):
            x, y, z = at(float(u), v, -0.05)
            out.box((x - 0.06, y - 0.06, 0.0), (x + 0.06, y + 0.06, z), "plain", _STEEL)
    return out.build()


def _cabinet() -> Mesh:
    """Build the cabinet of an inverter on a plinth, with louvres and a roof."""
    out = MeshBuilder()
    out.box((0, -0.65, 0), (2.4, 0.65, 0.2), "plain", (0.35, 0.34, 0.33))
    out.box((0.1, -0.55, 0.2), (2.3, 0.55, 2.1), "paint")
    out.box((0.02, -0.63, 2.1), (2.38, 0.63, 2.2), "paint", (0.8, 0.8, 0.8))
    for x in (0.3, 1.3):
        for z in np.arange(0.5, 1.7, 0.2):
            out.box((x, -0.57, z), (x + 0.8, -0.55, z + 0.08), "plain", _STEEL)
    return out.build()


def _planted_grave() -> Mesh:
    """Build a grave with a headstone, and earth and plants inside a kerb."""
    out = MeshBuilder()
    _headstone(out, 1.1)
    for y in (-0.55, 0.43):
        out.box((0.2, y, 0), (2.3, y + 0.12, 0.16), "paint")
    out.box((2.18, -0.43, 0), (2.3, 0.43, 0.16), "paint")
    out.box((0.2, -0.43, 0), (2.18, 0.43, 0.10), "plain", _EARTH)
    for x, y, wide in ((0.5, -0.2, 0.3), (0.9, 0.15, 0.35), (1.5, -0.1, 0.45), (1.9, 0.2, 0.2)):
        out.box((x, y - 0.5 * wide, 0.1), (x + wide, y + 0.5 * wide, 0.3), "plain", _GREEN)
    return out.build()


def _slab_grave() -> Mesh:
    """Build a grave with a headstone and a stone slab, with a bowl of flowers."""
    out = MeshBuilder()
    _headstone(out, 0.95)
    out.box((0.2, -0.55, 0), (2.3, 0.55, 0.12), "paint", (0.7, 0.7, 0.7))
    out.box((0.25, -0.48, 0.12), (2.24, 0.48, 0.26), "paint")
    out.box((1.7, 0.1, 0.26), (2.0, 0.4, 0.42), "plain", (0.25, 0.05, 0.05))
    return out.build()


def _cross_grave() -> Mesh:
    """Build a grave with a cross, and gravel inside a kerb."""
    out = MeshBuilder()
    out.box((0.05, -0.08, 0), (0.2, 0.08, 1.3), "paint")
    out.box((0.05, -0.4, 0.85), (0.2, 0.4, 1.02), "paint")
    out.box((0, -0.55, 0), (2.3, 0.55, 0.12), "paint", (0.75, 0.75, 0.75))
    out.box((0.3, -0.43, 0.12), (2.18, 0.43, 0.14), "plain", (0.30, 0.28, 0.25))
    out.box((0.5, -0.2, 0.14), (0.9, 0.2, 0.34), "plain", _GREEN)
    return out.build()


def _headstone(out: MeshBuilder, height: float) -> None:
    """Add a headstone with sloping shoulders at x = 0."""
    outline = [(-0.45, 0.0), (0.45, 0.0), (0.45, 0.8 * height), (0.2, height), (-0.2, height),
               (-0.45, 0.8 * height)]  # fmt: skip
    front, back = ([(x, y, z) for y, z in outline] for x in (0.2, 0.0))
    out.polygon(front, "paint")
    out.polygon(back[::-1], "paint")
    for k in range(len(outline)):
        j = (k + 1) % len(outline)
        out.polygon([front[k], back[k], back[j], front[j]], "paint", (0.85, 0.85, 0.85))


STRUCTURES: dict[str, Callable[[], Mesh]] = {
    "panel": partial(_panel, 12, 2),
    "wide_panel": partial(_panel, 6, 4),
    "cabinet": _cabinet,
    "planted_grave": _planted_grave,
    "slab_grave": _slab_grave,
    "cross_grave": _cross_grave,
}
"""The functions that build the meshes, by the name of the shape."""
