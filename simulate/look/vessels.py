"""Build meshes of boats and ships, in metres, with the bow along +x.

The parts that take the object's own colour have the material "paint".
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from simulate.look.mesh import Mesh, MeshBuilder
from simulate.place.world import Rgb

_WOOD: Rgb = (0.24, 0.15, 0.085)
_WHITE: Rgb = (0.55, 0.55, 0.53)
_TEAK: Rgb = (0.30, 0.21, 0.12)
_GLASS: Rgb = (0.025, 0.030, 0.034)
_STEEL: Rgb = (0.30, 0.30, 0.31)


def _boat() -> Mesh:
    """Build an open rowing boat, with its bow along +x."""
    out = MeshBuilder()
    x = np.array([0.0, 0.6, 1.8, 2.8, 3.6, 4.2])
    half = np.array([0.55, 0.70, 0.75, 0.62, 0.34, 0.04])
    rim, keel = np.full(6, 0.55), np.array([0.0, 0.0, 0.0, 0.02, 0.10, 0.3])
    rim[4:] = 0.60, 0.66
    for k in range(5):
        for side in (-1, 1):
            outer = [
                (x[k], side * half[k], rim[k]),
                (x[k], side * 0.6 * half[k], keel[k]),
                (x[k + 1], side * 0.6 * half[k + 1], keel[k + 1]),
                (x[k + 1], side * half[k + 1], rim[k + 1]),
            ]
            out.polygon(outer if side < 0 else outer[::-1], "paint")
            inner = [(a, 0.92 * b, c) for a, b, c in outer]
            out.polygon(inner[::-1] if side < 0 else inner, "plain", _WOOD)
        deck = [
            (x[k + j], side * 0.8 * half[k + j], 0.14 + keel[k + j])
            for j, side in ((0, -1), (1, -1), (1, 1), (0, 1))
        ]
        out.polygon(deck, "plain", (0.17, 0.10, 0.06))
    stern = [(0, 0.55, 0.55), (0, 0.33, 0.0), (0, -0.33, 0.0), (0, -0.55, 0.55)]
    out.polygon(stern, "paint")
    for at, wide in ((0.7, 0.62), (1.9, 0.68), (3.0, 0.50)):  # seats
        out.box((at, -wide, 0.36), (at + 0.26, wide, 0.41), "plain", (0.36, 0.24, 0.13))
    return out.build()


def _hull(out: MeshBuilder, length: float, half: float, rim: float, deck: Rgb) -> None:
    """Add a hull of a beam of 2 ``half`` with a level deck at ``rim``."""
    x = length * np.array([0.0, 0.25, 0.6, 0.8, 0.93, 1.0])
    wide = half * np.array([0.82, 0.98, 1.0, 0.80, 0.42, 0.02])
    for k in range(5):
        for side in (-1, 1):
            y0, y1 = side * wide[k], side * wide[k + 1]
            plank = [(x[k], y0, rim), (x[k], 0.85 * y0, 0.0), (x[k + 1], 0.85 * y1, 0.0),
                     (x[k + 1], y1, rim)]  # fmt: skip
            out.polygon(plank if side < 0 else plank[::-1], "paint")
        top = [(x[k], -wide[k], rim), (x[k + 1], -wide[k + 1], rim), (x[k + 1], wide[k + 1], rim),
               (x[k], wide[k], rim)]  # fmt: skip
        out.polygon(top, "plain", deck)
    stern = [(0, wide[0], rim), (0, 0.85 * wide[0], 0), (0, -0.85 * wide[0], 0), (0, -wide[0], rim)]
    out.polygon(stern, "paint")


def _yacht() -> Mesh:
    """Build a sailing yacht of 10 x 3 m with a cabin, a cockpit, and its sail on the boom."""
    out = MeshBuilder()
    _hull(out, 10.0, 1.5, 1.0, _TEAK)
    out.box((3.6, -0.95, 1.0), (7.2, 0.95, 1.4), "plain", _WHITE)
    out.box((4.2, -0.97, 1.12), (6.6, 0.97, 1.3), "glass", _GLASS)
    out.box((0.6, -0.8, 1.0), (3.4, 0.8, 1.03), "plain", (0.12, 0.09, 0.06))
    out.box((5.75, -0.07, 1.0), (5.9, 0.07, 12.5), "plain", _WHITE)
    out.box((1.6, -0.14, 1.9), (5.75, 0.14, 2.2), "plain", (0.05, 0.09, 0.20))
    out.box((5.8, -1.1, 7.5), (5.86, 1.1, 7.56), "plain", _WHITE)
    return out.build()


def _cruiser() -> Mesh:
    """Build a motor cruiser of 10 x 3 m with a cabin under a screen."""
    out = MeshBuilder()
    _hull(out, 10.0, 1.5, 1.3, _WHITE)
    cabin = [(2.6, 1.3), (7.4, 1.3), (5.8, 2.3), (2.6, 2.5)]
    out.prism(cabin, (-1.1, 1.1), "plain", _WHITE)
    screen = [(5.85, -1.0, 2.28), (7.35, -1.0, 1.36), (7.35, 1.0, 1.36), (5.85, 1.0, 2.28)]
    out.polygon([(x + 0.03, y, z + 0.03) for x, y, z in screen], "glass", _GLASS)
    out.box((0.4, -1.0, 1.3), (2.5, 1.0, 1.33), "plain", _TEAK)
    out.box((2.7, -0.9, 2.5), (4.2, 0.9, 3.2), "plain", (0.06, 0.10, 0.22))
    return out.build()


def _ship() -> Mesh:
    """Build a coaster of 50 x 10 x 10 m: hatches ahead of a bridge aft, with a mast."""
    out = MeshBuilder()
    _hull(out, 50.0, 5.0, 3.2, (0.16, 0.07, 0.05))
    for k in range(4):
        x = 13.0 + 7.2 * k
        shade = 0.30 + 0.05 * (k % 2)
        out.box((x, -3.4, 3.2), (x + 6.8, 3.4, 4.4), "plain", (shade, shade, 0.95 * shade))
    out.box((2.0, -4.0, 3.2), (11.0, 4.0, 6.0), "plain", _WHITE)
    out.box((4.0, -3.6, 6.0), (10.0, 3.6, 8.6), "plain", _WHITE)
    out.box((9.7, -3.4, 7.0), (10.06, 3.4, 8.2), "glass", _GLASS)
    out.box((4.4, -1.0, 8.6), (6.4, 1.0, 10.0), "paint")
    out.box((8.0, -0.1, 8.6), (8.2, 0.1, 10.0), "plain", _STEEL)
    for y in (-3.0, 3.0):
        out.box((1.0, y - 0.7, 6.0), (3.8, y + 0.7, 6.9), "plain", (0.45, 0.16, 0.02))
    out.box((43.5, -0.12, 3.2), (43.75, 0.12, 8.5), "plain", _WHITE)
    return out.build()


VESSELS: dict[str, Callable[[], Mesh]] = {
    "boat": _boat,
    "yacht": _yacht,
    "cruiser": _cruiser,
    "ship": _ship,
}
"""The functions that build the meshes, by the name of the shape."""
