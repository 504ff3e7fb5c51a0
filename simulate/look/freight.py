"""Build meshes of containers, stacks of containers, and container cranes, in metres.

The front of an object faces +x. The parts that take the object's own colour have the material
"paint".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from simulate.look.mesh import Mesh, MeshBuilder, merge
from simulate.place.containers import MAX_STACKED, STACK_VARIANTS
from simulate.place.objects import CONTAINER_M, STEEL_COLOURS
from simulate.place.world import Rgb

_DARK: Rgb = (0.03, 0.03, 0.032)
_STEEL: Rgb = (0.30, 0.30, 0.31)
_GLASS: Rgb = (0.025, 0.030, 0.034)


def _container(length: float) -> Mesh:
    """Build a shipping container with ribbed sides and roof, a frame, and door bars at +x."""
    out = MeshBuilder()
    width, height, inset = 2.44, 2.59, 0.04
    low, high = (
        (inset, -0.5 * width + inset, 0.1),
        (length - inset, 0.5 * width - inset, height - 0.04),
    )
    out.box(low, high, "paint")
    for x in np.arange(0.3, length - 0.2, 0.28):
        for y in (-0.5 * width, 0.5 * width - inset):
            out.box((x, y, 0.15), (x + 0.12, y + inset, height - 0.1), "paint", (0.8, 0.8, 0.8))
        out.box(
            (x, -1.05, height - 0.04), (x + 0.12, 1.05, height - 0.01), "paint", (0.8, 0.8, 0.8)
        )
    for x in (0.0, length - 0.12):
        for y in (-0.5 * width, 0.5 * width - 0.12):
            out.box((x, y, 0.0), (x + 0.12, y + 0.12, height), "paint", (0.6, 0.6, 0.6))
    for y in (-0.8, -0.3, 0.3, 0.8):
        out.box((length - 0.04, y, 0.2), (length + 0.02, y + 0.05, 2.4), "plain", (0.4, 0.4, 0.4))
    for y in (-0.5 * width - 0.003, 0.5 * width + 0.003):  # panel with the owner's name
        quad = [(0.35 * length, y, 1.5), (0.65 * length, y, 1.5), (0.65 * length, y, 2.2),
                (0.35 * length, y, 2.2)]  # fmt: skip
        out.polygon(quad if y < 0 else quad[::-1], "plain", (0.55, 0.55, 0.53))
    return out.build()


def _stack(length: float, count: int, variant: int) -> Mesh:
    """Build a stack of containers. The top container has the object's colour, the others their own.

    ``variant`` seeds the colours of the others.
    """
    rng = np.random.default_rng([35, variant])
    one = _container(length)
    height = float(np.ptp(one.vertices[:, 2]))
    painted = one.material == one.materials.index("paint")
    names = tuple("plain" if name == "paint" else name for name in one.materials)
    parts = [one.scale_by((1, 1, 1), (0, 0, (count - 1) * height))]
    for k in range(count - 1):
        colour = np.array(STEEL_COLOURS[int(rng.integers(len(STEEL_COLOURS)))], np.float32)
        tint = np.where(painted[:, None], one.tint * colour, one.tint)
        lower = replace(one, tint=tint, materials=names)
        parts.append(lower.scale_by((1, 1, 1), (0, 0, k * height)))
    return merge(parts)


def _gantry() -> Mesh:
    """Build a rubber-tyred gantry crane, 10 x 24 x 17 m, whose two frames span y."""
    out = MeshBuilder()
    for x in (0.8, 9.2):
        for y in (-11.5, 11.5):
            out.box((x - 0.4, y - 0.5, 1.2), (x + 0.4, y + 0.5, 15.6), "paint")
        out.box((x - 0.4, -12.0, 14.6), (x + 0.4, 12.0, 15.8), "paint", (0.9, 0.9, 0.9))
    for y in (-11.5, 11.5):
        out.box((0.0, y - 0.5, 0.9), (10.0, y + 0.5, 1.6), "paint", (0.8, 0.8, 0.8))
        out.box((0.8, y - 0.3, 13.6), (9.2, y + 0.3, 14.2), "paint")
        for x in (0.9, 2.2, 7.8, 9.1):
            out.box((x - 0.6, y - 0.35, 0.0), (x + 0.6, y + 0.35, 1.2), "plain", _DARK)
    for x in (2.6, 6.6):  # walkways along the frames
        out.box((x, -11.5, 15.2), (x + 0.8, 11.5, 15.3), "plain", _STEEL)
    out.box((1.2, 2.0, 15.8), (8.8, 6.0, 17.0), "plain", (0.42, 0.42, 0.41))  # trolley
    out.box((8.2, 2.6, 12.2), (9.8, 4.4, 14.4), "glass", _GLASS)  # cabin
    out.box((2.0, 3.4, 11.2), (8.0, 5.4, 11.6), "paint", (0.9, 0.6, 0.3))  # spreader
    for x in (2.4, 7.4):
        out.box((x, 4.3, 11.6), (x + 0.1, 4.4, 15.8), "plain", _DARK)
    return out.build()


def _stacker() -> Mesh:
    """Build a reach stacker of 11 x 4.2 x 5 m whose boom reaches ahead beside the cabin."""
    out = MeshBuilder()
    out.box((0.0, -1.9, 0.7), (2.2, 1.9, 2.4), "paint")  # counterweight
    out.box((2.2, -1.5, 0.8), (8.0, 1.5, 1.9), "paint", (0.9, 0.9, 0.9))
    out.box((4.0, -0.9, 1.9), (5.6, 0.9, 3.6), "glass", _GLASS)
    out.box((3.9, -1.0, 3.6), (5.7, 1.0, 3.75), "paint")
    boom = [(0.8, 3.0), (10.2, 4.4), (10.2, 5.0), (0.6, 3.7)]
    out.prism(boom, (1.0, 1.6), "paint", (0.85, 0.85, 0.85))
    out.box((0.6, 0.9, 2.0), (1.4, 1.7, 3.4), "paint")
    out.box((9.6, -2.1, 3.7), (11.0, 2.1, 4.1), "plain", (0.40, 0.30, 0.03))  # spreader
    turn = np.linspace(0, 2 * np.pi, 10, endpoint=False)
    for x, radius in ((1.6, 0.8), (6.8, 0.95)):
        ring = np.stack([x + radius * np.cos(turn), radius + radius * np.sin(turn)], -1)
        for side in (-1, 1):
            low, high = sorted((side * 1.2, side * 2.1))
            out.prism(ring, (low, high), "plain", _DARK)
    return out.build()


FREIGHT: dict[str, Callable[[], Mesh]] = {
    "gantry": _gantry,
    "stacker": _stacker,
    **{name: partial(_container, size[0]) for name, size in CONTAINER_M.items()},
    **{
        f"{name}_{count}x{variant}": partial(_stack, size[0], count, variant)
        for name, size in CONTAINER_M.items()
        for count in range(2, MAX_STACKED + 1)
        for variant in range(STACK_VARIANTS)
    },
}
"""The functions that build the meshes, by the name of the shape."""
