"""Build meshes of small objects of streets, parks, yards and farms, in metres.

The front of an object faces +x. The parts that take the object's own colour have the material
"paint".
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from simulate.look.mesh import Mesh, MeshBuilder
from simulate.place.world import Rgb

_WOOD: Rgb = (0.24, 0.15, 0.085)
_STEEL: Rgb = (0.30, 0.30, 0.31)
_DARK: Rgb = (0.03, 0.03, 0.032)
_STRAW: Rgb = (0.40, 0.31, 0.14)


def _ring(radius: float, count: int = 12) -> NDArray[np.float64]:
    turn = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.asarray(radius * np.stack([np.cos(turn), np.sin(turn)], -1))


def _drum(
    out: MeshBuilder,
    at: tuple[float, float],
    z: tuple[float, float],
    radii: tuple[float, float],
    material: str = "plain",
    tint: Rgb = (1.0, 1.0, 1.0),
) -> None:
    """Add an upright cylinder or cone frustum between two heights, closed at the top."""
    low, high = (
        np.column_stack([_ring(r) + at, np.full(12, h)]) for r, h in zip(radii, z, strict=True)
    )
    for i in range(12):
        j = (i + 1) % 12
        out.polygon([low[i], low[j], high[j], high[i]], material, tint)
    out.polygon(high, material, tint)


def _bin() -> Mesh:
    """Build a litter bin with a lid and a dark opening."""
    out = MeshBuilder()
    _drum(out, (0, 0), (0.0, 0.85), (0.24, 0.28), "paint")
    _drum(out, (0, 0), (0.85, 0.95), (0.26, 0.26), "plain", _DARK)
    _drum(out, (0, 0), (0.95, 1.05), (0.30, 0.16), "paint")
    return out.build()


def _hydrant() -> Mesh:
    out = MeshBuilder()
    _drum(out, (0, 0), (0.0, 0.08), (0.20, 0.20), "paint")
    _drum(out, (0, 0), (0.08, 0.70), (0.13, 0.13), "paint")
    _drum(out, (0, 0), (0.70, 0.85), (0.16, 0.06), "paint")
    out.box((-0.06, -0.24, 0.46), (0.06, 0.24, 0.60), "plain", (0.55, 0.55, 0.52))
    return out.build()


def _sign() -> Mesh:
    """Build a traffic sign whose plate faces +x."""
    out = MeshBuilder()
    out.box((-0.04, -0.04, 0), (0.04, 0.04, 2.3), "plain", _STEEL)
    plate = _ring(0.38, 8)
    for x, material, share in ((0.05, "paint", 1.0), (0.06, "plain", 0.7)):
        face = np.insert(share * plate + [0.0, 2.3], 0, x, axis=1)
        out.polygon(face, material, (0.75, 0.75, 0.73) if material == "plain" else (1, 1, 1))
        if material == "paint":
            out.polygon(face[::-1] - (0.01, 0, 0), "plain", _STEEL)
    return out.build()


def _bollard() -> Mesh:
    out = MeshBuilder()
    _drum(out, (0, 0), (0.0, 0.95), (0.12, 0.12), "paint")
    _drum(out, (0, 0), (0.95, 1.05), (0.12, 0.05), "plain", (0.7, 0.7, 0.68))
    return out.build()


def _table() -> Mesh:
    """Build a picnic table with two benches."""
    out = MeshBuilder()
    for y in (-0.36, -0.12, 0.12):
        out.box((0, y, 0.70), (1.9, y + 0.22, 0.76), "plain", _WOOD)
    for y in (-0.85, 0.57):
        out.box((0, y, 0.42), (1.9, y + 0.28, 0.47), "plain", _WOOD)
    for x in (0.25, 1.55):
        out.box((x, -0.72, 0.30), (x + 0.1, 0.72, 0.42), "plain", _WOOD)
        for y in (-0.62, 0.54):
            out.box((x, y, 0), (x + 0.1, y + 0.08, 0.30), "plain", _WOOD)
        out.box((x, -0.05, 0.30), (x + 0.1, 0.05, 0.70), "plain", _WOOD)
    return out.build()


def _bale() -> Mesh:
    """Build a round bale on its side, with its axis along y."""
    out = MeshBuilder()
    turn = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    for radius, half in ((0.75, 0.60), (0.45, 0.61), (0.20, 0.62)):
        ring = np.stack([radius * np.cos(turn), 0.75 + radius * np.sin(turn)], -1)
        shade = 0.7 + 0.3 * (radius > 0.5) + 0.15 * (radius < 0.3)
        out.prism(ring, (-half, half), "plain", tuple(shade * c for c in _STRAW))  # type: ignore[arg-type]
    return out.build()


def _pole() -> Mesh:
    """Build a power pole, with a crossarm along y and two insulators."""
    out = MeshBuilder()
    _drum(out, (0, 0), (0.0, 9.0), (0.17, 0.11), "paint")
    out.box((-0.06, -1.0, 8.35), (0.06, 1.0, 8.5), "paint")
    for y in (-0.85, 0.85):
        _drum(out, (0, y), (8.5, 8.75), (0.06, 0.04), "plain", (0.35, 0.16, 0.10))
    return out.build()


def _tank() -> Mesh:
    """Build an upright storage tank or silo with bands, a ladder and a conical top."""
    out = MeshBuilder()
    _drum(out, (0, 0), (0.0, 8.4), (2.9, 2.9), "paint")
    for z in (0.0, 2.8, 5.6, 8.2):
        _drum(out, (0, 0), (z, z + 0.2), (3.0, 3.0), "paint", (0.7, 0.7, 0.7))
    _drum(out, (0, 0), (8.4, 9.6), (2.95, 0.4), "paint", (0.85, 0.85, 0.85))
    _drum(out, (0, 0), (9.6, 10.0), (0.4, 0.4), "plain", _STEEL)
    out.box((2.88, -0.3, 0), (3.0, 0.3, 8.6), "plain", _STEEL)
    return out.build()


def _pallet() -> Mesh:
    """Build a stack of crates on a pallet."""
    out = MeshBuilder()
    for y in (-0.4, -0.08, 0.24):
        out.box((0, y, 0), (1.2, y + 0.16, 0.14), "plain", _WOOD)
    for i, (x0, x1) in enumerate(((0.0, 0.58), (0.62, 1.2))):
        for k in range(2):
            z = 0.16 + 0.52 * k
            shade = 0.8 + 0.1 * ((i + k) % 3)
            out.box((x0, -0.4, z), (x1, 0.4, z + 0.48), "paint", (shade, shade, shade))
    return out.build()


def _tractor() -> Mesh:
    out = MeshBuilder()
    turn = np.linspace(0, 2 * np.pi, 14, endpoint=False)
    for at, radius, y0, y1 in ((0.85, 0.85, 0.62, 1.1), (3.2, 0.5, 0.62, 0.95)):
        ring = np.stack([at + radius * np.cos(turn), radius + radius * np.sin(turn)], -1)
        hub = np.stack([at + 0.4 * radius * np.cos(turn), radius + 0.4 * radius * np.sin(turn)], -1)
        for side in (-1, 1):
            low, high = sorted((side * y0, side * y1))
            out.prism(ring, (low, high), "plain", _DARK)
            out.prism(hub, (low - 0.01, high + 0.01), "plain", (0.45, 0.35, 0.05))
    out.prism([(1.6, 0.7), (3.7, 0.7), (3.8, 1.35), (1.6, 1.6)], (-0.42, 0.42), "paint")
    out.box((0.3, -0.55, 0.6), (1.6, 0.55, 1.5), "paint")
    for side in (-1, 1):  # mudguards
        low, high = sorted((side * 0.6, side * 1.08))
        out.box((0.2, low, 1.68), (1.5, high, 1.76), "paint")
    out.box((0.35, -0.66, 1.5), (1.65, 0.66, 2.5), "glass", (0.03, 0.035, 0.04))
    out.box((0.25, -0.75, 2.5), (1.75, 0.75, 2.62), "paint")
    out.box((2.6, -0.05, 1.4), (2.7, 0.05, 2.2), "plain", _DARK)
    return out.build()


FURNITURE: dict[str, Callable[[], Mesh]] = {
    "bin": _bin,
    "hydrant": _hydrant,
    "sign": _sign,
    "bollard": _bollard,
    "table": _table,
    "bale": _bale,
    "pole": _pole,
    "tank": _tank,
    "pallet": _pallet,
    "tractor": _tractor,
}
"""The functions that build the meshes, by the name of the shape, which is also the class."""
