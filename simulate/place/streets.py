"""Lay streets: a grid of roads with gaps, bent by a smooth warp."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulate.place.builder import PAVEMENT_M, PlaceBuilder
from simulate.place.world import Road, polyline_length, polyline_points, ribbon

Array = NDArray[np.float64]

_STEP_M = 3.0  # distance between the points of a centre line
_MISSING_SHARE = 0.22  # share of the pieces of streets along v that do not exist
# Tone of the roads on the border of an area. Two neighbouring areas lay half of such a road each.
_BORDER_TONE = 0.5


@dataclass(frozen=True)
class StreetKind:
    """The appearance of all streets of a place.

    Attributes:
        surface: Ground class of the carriageways. Only roads have markings.
        verge: Ground class along them.
        widths_m: Widths of main and of other carriageways, metres.
        bend: Strength of the bends: 0 for straight streets and rectangular blocks.
    """

    surface: str = "road"
    verge: str = "pavement"
    widths_m: tuple[float, float] = (8.0, 6.2)
    bend: float = 1.0


TOWN_STREETS: Final = StreetKind()
"""Curved roads with pavements."""


@dataclass(frozen=True)
class Warp:
    """Maps plan metres (u, v) to world metres by a rotation and two smooth waves.

    The waves fade to nothing at ``half_side_m`` from the origin.
    """

    rotation: float
    amplitude: Array  # (2, 2) metres, wave x axis
    wave: Array  # (2, 2) radians per metre, wave x axis
    phase: Array  # (2,) radians
    half_side_m: float = np.inf

    @staticmethod
    def random(rng: np.random.Generator, pitch_m: float, bend: float) -> Warp:
        """Draw a warp with bends proportional to the distance between streets and to ``bend``."""
        heading = rng.uniform(0, 2 * np.pi, 2)
        wave_number = 2 * np.pi / (pitch_m * rng.uniform(2.4, 3.6, 2))
        return Warp(
            rotation=float(rng.uniform(-0.45, 0.45)),
            amplitude=bend * pitch_m * rng.uniform(0.05, 0.085, (2, 2)),
            wave=wave_number[:, None] * np.stack([np.cos(heading), np.sin(heading)], -1),
            phase=rng.uniform(0, 2 * np.pi, 2),
        )

    def __call__(self, uv: ArrayLike) -> Array:
        """Map plan points (..., 2) to world points (..., 2), metres."""
        p = np.asarray(uv, float)
        fade = np.maximum(1 - (p / self.half_side_m) ** 2, 0).prod(-1, keepdims=True)
        p = p + fade * (np.sin(p @ self.wave.T + self.phase) @ self.amplitude)
        cos, sin = np.cos(self.rotation), np.sin(self.rotation)
        return np.asarray(p @ np.array([[cos, sin], [-sin, cos]]))


@dataclass(frozen=True)
class StreetFrame:
    """Coordinates of a block: metres along a street (a) and away from it (b), from a corner.

    With ``sign`` -1 the frame is rotated by 180 degrees: a and b count from the opposite corner.
    """

    warp: Warp
    u: float
    v: float
    sign: int = 1

    def shift(self, a: float, b: float = 0.0) -> StreetFrame:
        """Return the same frame with its origin moved to (a, b)."""
        return StreetFrame(self.warp, self.u + self.sign * a, self.v + self.sign * b, self.sign)

    def point(self, a: ArrayLike, b: ArrayLike) -> Array:
        """Map local metres a, b to world points (..., 2)."""
        a, b = np.asarray(a, float), np.asarray(b, float)
        return self.warp(
            np.stack(np.broadcast_arrays(self.u + self.sign * a, self.v + self.sign * b), -1)
        )

    def yaw(self, a: float, b: float) -> float:
        """Return the world direction, radians, of the local a axis at (a, b)."""
        dx, dy = self.point(a + 0.5, b) - self.point(a - 0.5, b)
        return float(np.arctan2(dy, dx))

    def quad(self, a0: float, a1: float, b0: float, b1: float) -> Array:
        """Return the world corners (4, 2) of the local rectangle [a0, a1] x [b0, b1]."""
        return self.point([a0, a1, a1, a0], [b0, b0, b1, b1])


@dataclass(frozen=True)
class Block:
    """The land between four streets, inside their pavements, in plan metres."""

    warp: Warp
    u0: float
    u1: float
    v0: float
    v1: float

    @property
    def length(self) -> float:
        """Return the extent along u, metres."""
        return self.u1 - self.u0

    @property
    def depth(self) -> float:
        """Return the extent along v, metres."""
        return self.v1 - self.v0

    def front(self, sign: int) -> StreetFrame:
        """Return the frame of the street at v0 (sign +1) or at v1 (sign -1)."""
        if sign > 0:
            return StreetFrame(self.warp, self.u0, self.v0)
        return StreetFrame(self.warp, self.u1, self.v1, -1)

    def centre(self) -> Array:
        """Return the middle of the block in the world, (2,) metres."""
        return self.warp([0.5 * (self.u0 + self.u1), 0.5 * (self.v0 + self.v1)])


class Lattice(NamedTuple):
    """The lines of streets in plan coordinates, before the warp.

    In each pair, the first array is for the streets along v, the second for the streets along u.

    Attributes:
        warp: Warp of the plan.
        lines: Positions (U,) of the streets along v, and (V,) of those along u, metres.
        main: Whether each street is a main road, (U,) and (V,).
        widths: Widths of the carriageways, (U,) and (V,) metres.
        present: Whether each piece of a street along v exists, (U, V - 1). Missing pieces make T
            junctions.
        bounded: Whether the outermost streets are the border of the area.
    """

    warp: Warp
    lines: tuple[Array, Array]
    main: tuple[NDArray[np.bool_], NDArray[np.bool_]]
    widths: tuple[Array, Array]
    present: NDArray[np.bool_]
    bounded: bool


def draw_lattice(
    rng: np.random.Generator, side_m: float, pitch_m: float, kind: StreetKind
) -> Lattice:
    """Draw rotated streets about ``pitch_m`` metres apart that cover an area and its edges."""
    warp = Warp.random(rng, pitch_m, kind.bend)
    cells = int(np.ceil(0.5 * side_m * 1.3 / pitch_m)) + 1  # on each side of the origin
    us, vs = (
        pitch_m * (np.arange(-cells, cells + 1) + rng.uniform(-0.14, 0.14, 2 * cells + 1))
        for _ in range(2)
    )
    main = [rng.random(2 * cells + 1) < 0.35 for _ in range(2)]
    main[int(rng.integers(2))][cells] = True
    u_widths, v_widths = (np.where(m, *kind.widths_m) for m in main)
    present = rng.random((len(us), len(vs) - 1)) > _MISSING_SHARE
    present[main[0]] = True
    return Lattice(warp, (us, vs), (main[0], main[1]), (u_widths, v_widths), present, bounded=False)


def draw_bounded_lattice(
    rng: np.random.Generator, side_m: float, pitch_m: float, kind: StreetKind
) -> Lattice:
    """Draw streets about ``pitch_m`` metres apart; the outermost streets are the area's borders.

    Two neighbouring areas lay one half each of the street on their border. Border streets are
    straight, unmarked and as wide as main roads, so that the halves fit together.
    """
    drawn = Warp.random(rng, pitch_m, kind.bend)
    warp = replace(drawn, rotation=0.0, half_side_m=0.5 * side_m)
    count = max(2, round(side_m / pitch_m))
    lines, main, widths = [], [], []
    for _ in range(2):
        shift = rng.uniform(-0.14, 0.14, count + 1)
        is_main = rng.random(count + 1) < 0.35
        shift[[0, -1]], is_main[[0, -1]] = 0.0, False
        width = np.where(is_main, *kind.widths_m)
        width[[0, -1]] = kind.widths_m[0]
        lines.append((np.arange(count + 1) - 0.5 * count + shift) * side_m / count)
        main.append(is_main)
        widths.append(width)
    present = rng.random((count + 1, count)) > _MISSING_SHARE
    present[main[0]] = present[[0, -1]] = True
    return Lattice(
        warp,
        (lines[0], lines[1]),
        (main[0], main[1]),
        (widths[0], widths[1]),
        present,
        bounded=True,
    )


def lay_streets(
    builder: PlaceBuilder, lattice: Lattice, pitch_m: float, kind: StreetKind
) -> list[Block]:
    """Lay roads, verges and markings, and return the blocks between them.

    The blocks cover the area, and those nearest the origin come first.
    """
    warp, present = lattice.warp, lattice.present
    (us, vs), (u_main, v_main), (u_widths, v_widths) = lattice.lines, lattice.main, lattice.widths
    roads = []
    for v, width, is_main in zip(vs, v_widths, v_main, strict=True):
        u = np.arange(us[0], us[-1], _STEP_M)
        line = warp(np.stack([u, np.full_like(u, v)], -1))
        roads.append(Road(line, float(width), bool(is_main)))
    for k, u in enumerate(us):
        for j, (v0, v1) in enumerate(pairwise(vs)):
            if not present[k, j]:
                continue
            v = np.linspace(v0, v1, max(2, int((v1 - v0) / _STEP_M) + 1))
            line = warp(np.stack([np.full_like(v, u), v], -1))
            roads.append(Road(line, float(u_widths[k]), bool(u_main[k])))
    builder.lay_roads(roads)
    _pave(builder, warp(np.stack(np.meshgrid(us, vs), -1).reshape(-1, 2)), kind)
    if lattice.bounded:
        for line in _border_lines(builder.side_m):
            builder.paint(kind.surface, ribbon(line, kind.widths_m[0]), _BORDER_TONE)

    blocks = []
    for i in range(len(us) - 1):
        for j in range(len(vs) - 1):
            # The warp may narrow a block, so the inset is a little wider than the pavement.
            inset_u, inset_v = (
                0.5 * w[k : k + 2] * 1.05 + PAVEMENT_M + 0.5
                for w, k in ((u_widths, i), (v_widths, j))
            )
            blocks.append(
                Block(
                    warp,
                    us[i] + inset_u[0],
                    us[i + 1] - inset_u[1],
                    vs[j] + inset_v[0],
                    vs[j + 1] - inset_v[1],
                )
            )
    reach = 0.5 * builder.side_m + 0.75 * pitch_m
    blocks = [b for b in blocks if np.abs(b.centre()).max() < reach]
    return sorted(blocks, key=lambda b: float(np.linalg.norm(b.centre())))


def _border_lines(side_m: float) -> Iterator[Array]:
    """Yield the four sides (2, 2) of the area, metres."""
    corners = 0.5 * side_m * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    for k in range(4):
        yield corners[[k, (k + 1) % 4]]


def divide(blocks: Sequence[Block], side_m: float, count: int) -> list[list[Block]]:
    """Divide blocks into ``count`` bands along u, as equal in width as whole columns allow.

    Each band keeps the order of the blocks. A column outside the area belongs to the nearest band.
    """
    columns = sorted({(b.u0, b.u1) for b in blocks})
    inside = [c for c in columns if abs(sum(c)) < 1.1 * side_m]
    bands = np.array_split(np.arange(len(inside)), count)
    starts = [inside[band[0]][0] for band in bands[1:]]
    band_of = [sum(block.u0 >= start for start in starts) for block in blocks]
    return [[b for b, w in zip(blocks, band_of, strict=True) if w == k] for k in range(count)]


def outlines(bands: Sequence[Sequence[Block]], side_m: float) -> list[Array]:
    """Return the world outline (K, 2) of each band of blocks, between the middles of streets."""
    warp = bands[0][0].warp
    edges = [max(b.u1 for b in a) + min(b.u0 for b in c) for a, c in pairwise(bands)]
    ends = [-side_m, *(0.5 * edge for edge in edges), side_m]
    across = np.arange(-side_m, side_m + _STEP_M, _STEP_M)
    sides = [warp(np.stack([np.full_like(across, u), across], -1)) for u in ends]
    return [np.vstack([left, right[::-1]]) for left, right in pairwise(sides)]


def _pave(builder: PlaceBuilder, junctions: Array, kind: StreetKind) -> None:
    """Paint verges, carriageways and markings of all roads, which meet at junctions (M, 2)."""
    turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    disc = np.stack([np.cos(turn), np.sin(turn)], -1)
    for road in builder.roads:
        builder.paint(kind.verge, ribbon(road.line, road.width_m + 2 * PAVEMENT_M))
    for road in builder.roads:
        tone = 0.35 + 0.3 * builder.rng.random()
        builder.paint(kind.surface, ribbon(road.line, road.width_m), tone)
    for junction in junctions:
        if len(builder.roads_within(junction[None], 0.5)) < 2:
            continue
        # Carriageways widen at junctions, with rounded kerbs.
        builder.paint(kind.surface, junction + 5.2 * disc, 0.45)
    for road in builder.roads:
        if road.main and kind.surface == "road":
            _centre_line(builder, road, junctions)
            _crossings(builder, road, junctions)


def _centre_line(builder: PlaceBuilder, road: Road, junctions: Array) -> None:
    """Paint the dashed centre line of a road, except near junctions (M, 2)."""
    dash, period = 3.0, 7.0
    starts = np.arange(0.0, polyline_length(road.line) - dash, period)
    a, _ = polyline_points(road.line, starts)
    b, _ = polyline_points(road.line, starts + dash)
    gap = np.linalg.norm(0.5 * (a + b)[:, None] - junctions, axis=-1).min(1)
    for p, q in zip(a[gap > 9.0], b[gap > 9.0], strict=True):
        builder.mark([p, q], 0.14)


def _crossings(builder: PlaceBuilder, road: Road, junctions: Array) -> None:
    """Paint zebra crossings before some of the junctions that this road passes."""
    for junction in junctions:
        near = np.linalg.norm(road.line - junction, axis=1)
        if near.min() > _STEP_M:
            continue
        at = float(near.argmin()) / (len(road.line) - 1) * polyline_length(road.line)
        for side in (-1, 1):
            s = at + side * 9.0
            if not 0 < s < polyline_length(road.line) or not builder.chance(0.45):
                continue
            (middle,), (along,) = polyline_points(road.line, s)
            across = np.array([-along[1], along[0]])
            for offset in np.arange(-0.5 * road.width_m + 0.7, 0.5 * road.width_m - 0.4, 1.0):
                stripe = middle + offset * across
                builder.mark([stripe - 1.5 * along, stripe + 1.5 * along], 0.5)
