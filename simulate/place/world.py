"""A simulated place as plain data: terrain, ground cover and oriented objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from objconnect.scene.bundle.labels import CLASSES
from objconnect.scene.geometry.rectangle import rectangle

Rgb = tuple[float, float, float]
Slope = tuple[float, float]

MAX_OBJECT_ID = 32767  # the largest value of Blender's Object.pass_index
MIRRORED_M = 64.0
"""Width (m) of the margin around a place in which the ground is mirrored."""


def _reflect(index: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    """Reflect whole-cell indices into [0, size): ... 1 0 | 0 1 ... size-1 | size-1 ..."""
    index = np.mod(index, 2 * size)
    return np.where(index < size, index, 2 * size - 1 - index)


@dataclass(frozen=True)
class Heightfield:
    """Heights on a square grid of nodes centred on the origin, mirrored beyond its edge.

    ``nodes`` is (n, n) float64 metres; rows run from south to north, columns from west to east.
    """

    nodes: NDArray[np.float64]
    spacing_m: float

    @property
    def half_side_m(self) -> float:
        """Return the distance from the origin to the edge of the grid, metres."""
        return 0.5 * (len(self.nodes) - 1) * self.spacing_m

    def height(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Return the bilinear ground height in metres at world x, y (metres, of equal shape)."""
        last = len(self.nodes) - 1
        cells = []
        for coordinate in (x, y):
            # A triangle wave folds positions outside the grid back into it.
            t = (np.asarray(coordinate, float) + self.half_side_m) / self.spacing_m
            t = last - np.abs(np.mod(t, 2 * last) - last)
            i = np.clip(np.floor(t).astype(np.int64), 0, last - 1)
            cells.append((i, t - i))
        (i, s), (j, t) = cells
        z = self.nodes
        south = (1 - s) * z[j, i] + s * z[j, i + 1]
        north = (1 - s) * z[j + 1, i] + s * z[j + 1, i + 1]
        return np.asarray((1 - t) * south + t * north)


@dataclass(frozen=True)
class Road:
    """A carriageway: centre line (K, 2) and width in metres, and whether it is a main road.

    Main roads have painted centre lines and zebra crossings.
    """

    line: NDArray[np.float64]
    width_m: float
    main: bool


@dataclass(frozen=True)
class Region:
    """A polygon (K, 2) in metres of one ground class.

    Its tone, 0 to 1, makes neighbours look different.
    """

    class_name: str
    polygon: NDArray[np.float64]
    tone: float = 0.5


@dataclass(frozen=True)
class Marking:
    """A painted line (K, 2) in metres, with its width in metres."""

    line: NDArray[np.float64]
    width_m: float


@dataclass(frozen=True)
class Kerb:
    """A pavement raised above the ground along one side of a carriageway.

    Attributes:
        front: The kerb (K, 2), metres.
        back: The far edge (K, 2), metres.
        rise: Height (K,) above the ground at each pair of points, metres; 0 at both ends.
    """

    front: NDArray[np.float64]
    back: NDArray[np.float64]
    rise: NDArray[np.float64]


@dataclass(frozen=True)
class Surroundings:
    """A named part of a place: its outline (K, 2) in metres."""

    name: str
    outline: NDArray[np.float64]


@dataclass(frozen=True)
class Ground:
    """Ground cover on a raster centred on the origin; rows run from south to north.

    ``labels`` and ``tone`` are (n, n) uint8. ``tone`` is the tone of the regions times 255.
    """

    texel_m: float
    labels: NDArray[np.uint8]
    tone: NDArray[np.uint8]
    markings: tuple[Marking, ...]

    def texel(self, x: ArrayLike, y: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the row and the column at world x, y (metres, of equal shape), mirrored beyond
        the raster."""
        n = len(self.labels)
        column, row = (
            _reflect(np.floor(np.asarray(c, float) / self.texel_m + 0.5 * n).astype(np.int64), n)
            for c in (x, y)
        )
        return row, column

    def label(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.uint8]:
        """Return the semantic label at world x, y (metres, of equal shape).

        The labels are mirrored within ``MIRRORED_M`` beyond the raster, and are grass farther out.
        """
        half_m = 0.5 * len(self.labels) * self.texel_m
        beyond = np.maximum(np.abs(x), np.abs(y)) - half_m
        row, column = self.texel(x, y)
        return np.asarray(
            np.where(beyond < MIRRORED_M, self.labels[row, column], CLASSES["grass"]), np.uint8
        )


class Facade(IntEnum):
    """Kinds of facades. The numbers seed the images, so they never change."""

    HOUSE_WHITE_FRAMES = 0
    HOUSE_GREEN_SHUTTERS = 1
    HOUSE_DARK_FRAMES = 2
    HOUSE_BROWN_SHUTTERS = 3
    SLAB_WHITE_FRAMES = 4
    SLAB_WOODEN_FRAMES = 5
    HALL_CLADDING = 6
    SHED_BOARDS = 7
    SHOPS_PALE_STONE = 8
    SHOPS_DARK_STONE = 9
    SHOPS_WHITE_STONE = 10


@dataclass(frozen=True)
class Imagery:
    """The appearance of a site, a real place, from above, on the raster of its ``Ground``.

    Attributes:
        albedo: Albedo (n, n, 3) uint8, sRGB-coded, in the season of the orthophoto.
        snow: Share of the snow that stays by class, slope and shelter, (n, n) uint8 of 255.
        season: Name of the orthophoto's season.
    """

    albedo: NDArray[np.uint8]
    snow: NDArray[np.uint8]
    season: str


Roof = Literal["gable", "hip", "flat"]
Roofing = Literal["tile", "slate", "metal", "flat"]


@dataclass(frozen=True)
class BuildingStyle:
    """The appearance of a building inside its box.

    Attributes:
        floors: Number of floors.
        roof: Shape of the roof. Ridges run along the x axis of the box.
        roof_height_m: Height of the roof above the walls, metres.
        overhang_m: Overhang of the roof beyond the walls, metres.
        facade: Kind of the facade.
        roofing: Material of the roof.
        wall_rgb: Albedo of the walls, linear RGB.
        roof_rgb: Albedo of the roof, linear RGB.
        main_depth_share: Share of the box's depth that the main body takes. The main body has the
            whole width of the box.
        wing_width_share: Share of the box's width that the wing of an L-shaped building takes. Both
            shares are 1 where the footprint is a rectangle.
        detail: Seed of chimneys, vents and windows.
    """

    floors: int
    roof: Roof
    roof_height_m: float
    overhang_m: float
    facade: Facade
    roofing: Roofing
    wall_rgb: Rgb
    roof_rgb: Rgb
    main_depth_share: float
    wing_width_share: float
    detail: int


def slope_under(terrain: Heightfield, corners: NDArray[np.float64]) -> Slope:
    """Return the rise along the length and the width of a rectangle (4, 2), metres per metre.

    The corners are those of ``rectangle``: the first edge and the third are along its length.
    """
    middles = 0.5 * (corners + np.roll(corners, -1, 0))
    length, width = np.linalg.norm(np.diff(corners[:3], axis=0), axis=1)
    right, front, left, back = terrain.height(middles[:, 0], middles[:, 1])
    return float((front - back) / length), float((left - right) / width)


def rise(slope: Slope, size: ArrayLike) -> float:
    """Return the rise between the lowest and the highest corner of a rectangle, metres."""
    return float(np.abs(slope) @ np.asarray(size, float)[:2])


@dataclass(frozen=True)
class WorldObject:
    """A labelled object: an oriented box and the name of the mesh that fills it.

    ``centre`` (3,) is in world metres, ``size`` (3,) in metres along the box's axes, and ``yaw`` in
    radians anticlockwise from east. ``shape`` names the mesh. ``colour`` is linear RGB. Buildings
    have a style. ``driven`` vehicles are in traffic, with their lights on at night. ``slope`` is
    the rise of the ground along the length and the width of an object that leans with it, metres
    per metre; None for an upright object. The box is always upright, and higher if its object
    leans. ``key`` seeds the random properties of an object in a tile.
    """

    id: int
    class_name: str
    centre: NDArray[np.float64]
    size: NDArray[np.float64]
    yaw: float
    shape: str
    colour: Rgb
    style: BuildingStyle | None = None
    driven: bool = False
    slope: Slope | None = None
    key: int | None = None

    @property
    def random_key(self) -> int:
        """Return the seed of the object's random properties: ``key``, or ``id`` without a key."""
        return self.id if self.key is None else self.key

    @property
    def height_m(self) -> float:
        """Return the height of the object, metres. The box of a leaning object is higher."""
        return float(self.size[2]) - (0.0 if self.slope is None else rise(self.slope, self.size))

    def footprint(self) -> NDArray[np.float64]:
        """Return the four corners of the box seen from above, (4, 2) metres, anticlockwise."""
        return rectangle(self.centre[:2], self.size[:2], self.yaw)


@dataclass(frozen=True)
class World:
    """A square place of ``side_m`` metres, centred on the origin, east-north-up, Z up.

    Its surroundings cover the place without overlap, or there are none. The attributes from
    ``imagery`` to ``level_m`` belong to sites, whose terrain is the surface including buildings and
    trees.

    Attributes:
        imagery: The appearance of a site.
        bare_ground: Ground of a site below buildings and trees, the reference of flight altitudes.
        margin_m: Width of the margin around the place with terrain and ground, metres.
        level_m: Height of the land around the place, metres.
        tiles: The tiles of a part of a tiled place, from south to north and from west to east, each
            with its own coordinates. The ground of each is textured by its own seed.
        land_heights: Heights (K,) of the whole place around a tile, metres; None if this place is
            not a tile.
    """

    seed: int
    side_m: float
    terrain: Heightfield
    roads: tuple[Road, ...]
    ground: Ground
    objects: tuple[WorldObject, ...]
    kerbs: tuple[Kerb, ...] = ()
    surroundings: tuple[Surroundings, ...] = ()
    imagery: Imagery | None = None
    bare_ground: Heightfield | None = None
    margin_m: float = 0.0
    level_m: float = 0.0
    tiles: tuple[tuple[World, ...], ...] = ()
    land_heights: NDArray[np.float64] | None = None

    @property
    def flight_ground(self) -> Heightfield:
        """Return the ground to which altitudes of flights refer."""
        return self.terrain if self.bare_ground is None else self.bare_ground


def arc_lengths(line: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the arc length (K,) of each point of a line (K, 2), metres."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])


def polyline_points(
    line: NDArray[np.float64], arc_m: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points (M, 2) and unit directions (M, 2) at arc lengths (M,), metres, on a line."""
    arc = np.atleast_1d(np.asarray(arc_m, float))
    steps = np.diff(line, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    start = arc_lengths(line)
    i = np.clip(np.searchsorted(start, arc, side="right") - 1, 0, len(steps) - 1)
    direction = steps[i] / lengths[i, None]
    return line[i] + (arc - start[i])[:, None] * direction, direction


def polyline_length(line: NDArray[np.float64]) -> float:
    """Return the length in metres of a line (K, 2)."""
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def ribbon(line: NDArray[np.float64], width_m: float) -> NDArray[np.float64]:
    """Return the outline (2 K, 2) of a line (K, 2) that is ``width_m`` metres wide."""
    tangent = np.gradient(line, axis=0)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], -1)
    normal *= 0.5 * width_m / np.linalg.norm(normal, axis=1, keepdims=True)
    return np.vstack([line + normal, (line - normal)[::-1]])


def class_lookup(objects: Sequence[WorldObject]) -> NDArray[np.uint8]:
    """Return a table (max id + 1,) of semantic labels by object id. Entry 0 is 0."""
    table = np.zeros(max((o.id for o in objects), default=0) + 1, np.uint8)
    for o in objects:
        table[o.id] = CLASSES[o.class_name]
    return table
