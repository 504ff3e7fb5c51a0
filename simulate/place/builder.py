"""The builder of a simulated place, in which the footprints of objects do not overlap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeVar

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.rectangle import overlap, rectangle
from simulate.place.grid import CircleGrid
from simulate.place.world import (
    MAX_OBJECT_ID,
    BuildingStyle,
    Heightfield,
    Marking,
    Region,
    Rgb,
    Road,
    Slope,
    WorldObject,
    rise,
    slope_under,
)

Array = NDArray[np.float64]
T = TypeVar("T")

PAVEMENT_M = 2.0  # width of the pavement on each side of a road


@dataclass(frozen=True)
class ObjectSpec:
    """An object without a position.

    Attributes:
        class_name: class of the object.
        shape: name of its mesh.
        size: length, width and height, metres.
        colour: linear albedo of its painted parts.
        style: style of a building; None otherwise.
        driven: whether it is a vehicle in traffic.
        leans: whether it leans with the ground in a steep place.
    """

    class_name: str
    shape: str
    size: Sequence[float]
    colour: Rgb = (1.0, 1.0, 1.0)
    style: BuildingStyle | None = None
    driven: bool = False
    leans: bool = False


@dataclass(frozen=True)
class Footing:
    """The ground on which an object may stand, and its distance to other objects.

    Attributes:
        on_road: whether it may stand on roads and pavements.
        on_reserved: whether it may stand on reserved ground.
        gap_m: minimum distance to other objects, per side.
    """

    on_road: bool = False
    on_reserved: bool = False
    gap_m: float = 0.15


OPEN_GROUND: Final = Footing()
"""The footing of most objects: ground that is neither road, pavement nor reserved."""


class PlaceBuilder:
    """A place under construction: its terrain, roads, ground cover and objects.

    An object must lie inside the area and must not overlap earlier objects, roads with their
    pavements, or reserved ground such as driveways, unless its footing allows it.
    """

    def __init__(
        self, side_m: float, terrain: Heightfield, rng: np.random.Generator, steep: bool = False
    ) -> None:
        self.side_m = side_m
        self.terrain = terrain
        self.rng = rng
        self._is_steep = steep
        self.roads: tuple[Road, ...] = ()
        self.regions: list[Region] = []
        self.markings: list[Marking] = []
        self.objects: list[WorldObject] = []
        self._drawn: dict[Callable[..., Any], Any] = {}
        self._claims: list[Array] = []
        self._reserved: list[bool] = []  # whether each claim is only reserved ground
        self._circles = CircleGrid()  # circles around the claims
        # Every straight piece of every road: start, step, half width and index of its road.
        self._pieces = np.empty((0, 4))
        self._half_width = np.empty(0)
        self._road_of = np.empty(0, int)
        self._reach = CircleGrid()  # circles around the carriageway of each piece

    def choose(self, options: Sequence[T]) -> T:
        """Draw one of the options, with equal probabilities."""
        return options[int(self.rng.integers(len(options)))]

    def chance(self, probability: float) -> bool:
        """Return True with a probability."""
        return bool(self.rng.random() < probability)

    def once(self, draw: Callable[[PlaceBuilder], T]) -> T:
        """Return the result of the first call of ``draw``: a property of the whole place."""
        if draw not in self._drawn:
            self._drawn[draw] = draw(self)
        drawn: T = self._drawn[draw]
        return drawn

    def lay_roads(self, roads: Sequence[Road]) -> None:
        """Set the roads that later objects keep off."""
        self.roads = tuple(roads)
        pieces = np.vstack([np.c_[r.line[:-1], np.diff(r.line, axis=0)] for r in roads])
        counts = [len(r.line) - 1 for r in roads]
        half_width = np.repeat([0.5 * r.width_m for r in roads], counts)
        road_of = np.repeat(np.arange(len(roads)), counts)
        near = np.abs(pieces[:, :2]).max(1) < 0.5 * self.side_m + 30.0
        self._pieces, self._half_width, self._road_of = (
            pieces[near],
            half_width[near],
            road_of[near],
        )
        self._reach = CircleGrid()
        middle = self._pieces[:, :2] + 0.5 * self._pieces[:, 2:]
        radius = 0.5 * np.hypot(*self._pieces[:, 2:].T) + self._half_width
        for centre, r in zip(middle, radius.tolist(), strict=True):
            self._reach.add(centre, r)

    def roads_within(self, points: Array, clear_m: float) -> set[int]:
        """Return the indices of roads with a carriageway within ``clear_m`` of any point (M, 2)."""
        centre = points.mean(0)
        near = self._reach.find_overlapping(
            centre, float(np.hypot(*(points - centre).T).max()) + clear_m
        )
        if not near:
            return set()
        a, d = self._pieces[near, :2], self._pieces[near, 2:]
        p = points[:, None] - a
        t = np.clip((p * d).sum(-1) / (d * d).sum(-1), 0, 1)
        distance = np.linalg.norm(p - t[..., None] * d, axis=-1).min(0)
        hit = distance < self._half_width[near] + clear_m
        return set(self._road_of[near][hit].tolist())

    def paint(self, class_name: str, polygon: Array, tone: float = 0.5) -> None:
        """Paint a polygon (K, 2) of a ground class and tone over what was painted before."""
        self.regions.append(Region(class_name, polygon, tone))

    def mark(self, line: ArrayLike, width_m: float = 0.12) -> None:
        """Paint a white line (K, 2)."""
        self.markings.append(Marking(np.asarray(line, float), width_m))

    def is_free(self, position: ArrayLike, size: Sequence[float], yaw: float) -> bool:
        """Return whether no object or reserved ground lies in a rectangle; roads are ignored.

        The rectangle has the size (2,), metres, and its middle at a point (2,).
        """
        return not self._is_occupied(rectangle(position, size, yaw), on_reserved=False)

    def reserve(self, polygon: Array) -> None:
        """Reserve a rectangle (4, 2). Only objects placed ``on_reserved`` may stand there later."""
        self._claim(polygon, reserved=True)

    def place(
        self,
        spec: ObjectSpec,
        position: ArrayLike,
        yaw: float,
        footing: Footing = OPEN_GROUND,
    ) -> bool:
        """Place an object where there is room for it.

        Buildings stand on the lowest ground under them, hedges and fences follow the ground,
        vehicles lean with it in a steep place, and all other objects stand on the ground under
        their centre.

        Args:
            spec: The object.
            position: Centre (2,) of the object's box, metres.
            yaw: Direction of the object's length, radians anticlockwise from east.
            footing: Ground on which the object may stand, and its distance to other objects.

        Returns:
            Whether there was room.

        Raises:
            InputError: There are more objects than ids.
        """
        position = np.asarray(position, float)
        length, width, height = spec.size
        corners = rectangle(position, (length, width), yaw)
        if np.abs(corners).max() > 0.5 * self.side_m:
            return False
        gap_m = footing.gap_m
        grown = rectangle(position, (length + 2 * gap_m, width + 2 * gap_m), yaw)
        if self._is_occupied(grown, footing.on_reserved):
            return False
        if not footing.on_road and self.roads_within(_outline(grown), PAVEMENT_M):
            return False
        self._claim(corners, reserved=False)

        samples = np.vstack([corners, 0.5 * (corners + np.roll(corners, 1, 0)), position])
        ground = self.terrain.height(samples[:, 0], samples[:, 1])
        base = float(ground[-1])
        if spec.class_name == "building":
            base = float(ground.min())
        elif spec.class_name in ("hedge", "fence"):
            base = float(ground.min())
            height += float(np.ptp(ground))
        centre = np.array([position[0], position[1], base + 0.5 * height])
        slope = slope_under(self.terrain, corners) if spec.leans and self._is_steep else None
        if slope is not None:
            height += rise(slope, spec.size)
        self._add(spec, centre, np.array([length, width, height], float), yaw, slope)
        return True

    def hang(
        self,
        class_name: str,
        ends: Array,
        heights: tuple[float, float],
        width_m: float,
        low_m: float,
    ) -> None:
        """Place an object that hangs between two points and occupies no ground.

        Args:
            class_name: Class of the object.
            ends: The two ends (2, 2) of the object, seen from above, metres.
            heights: Heights of the two ends, world metres.
            width_m: Width of the object, metres.
            low_m: Height of the lowest point of the object, world metres.
        """
        a, b = ends
        size = np.array([np.linalg.norm(b - a), width_m, max(heights) - low_m])
        centre = np.array([*(0.5 * (a + b)), 0.5 * (max(heights) + low_m)])
        yaw = float(np.arctan2(*(b - a)[::-1]))
        cable = ObjectSpec(class_name, class_name, size.tolist(), (0.05, 0.05, 0.05))
        self._add(cable, centre, size, yaw)

    def flood(self, shore: Array, bank_m: float) -> None:
        """Paint still water inside a shore (K, 2), and level the ground under the water.

        The ground around the water slopes to it over ``bank_m`` metres, beyond the last cell of the
        terrain that the water touches. Flood an area before objects are placed on it.
        """
        spacing, nodes = self.terrain.spacing_m, self.terrain.nodes.copy()
        axis = np.arange(len(nodes)) * spacing - self.terrain.half_side_m
        margin = 1.5 * spacing
        slices = [
            slice(*np.searchsorted(axis, [low - margin - bank_m, high + margin + bank_m]))
            for low, high in zip(shore.min(0), shore.max(0), strict=True)
        ]
        columns, rows = slices
        outline = shore.astype(np.float32)
        outside = np.array(
            [
                [-cv2.pointPolygonTest(outline, (x, y), True) for x in axis[columns]]
                for y in axis[rows]
            ]
        )
        if outside.size == 0:
            return
        level = float(self.terrain.height(*shore.T).mean()) - 0.3
        share = np.clip((outside - margin) / bank_m, 0.0, 1.0)
        share = share * share * (3 - 2 * share)
        nodes[rows, columns] = level + share * (nodes[rows, columns] - level)
        self.terrain = Heightfield(nodes, spacing)
        self.paint("water", shore)

    def _add(
        self,
        spec: ObjectSpec,
        centre: Array,
        size: Array,
        yaw: float,
        slope: Slope | None = None,
    ) -> None:
        """Add an object with a box of ``size`` (3,) metres, which may exceed ``spec.size``."""
        number = len(self.objects) + 1
        if number > MAX_OBJECT_ID:
            raise InputError(
                f"a place of {self.side_m:g} m a side has more than {MAX_OBJECT_ID} objects, the "
                "maximum: choose a smaller area"
            )
        yaw = float(np.angle(np.exp(1j * yaw)))
        self.objects.append(
            WorldObject(
                number,
                spec.class_name,
                centre,
                size,
                yaw,
                spec.shape,
                spec.colour,
                spec.style,
                spec.driven,
                slope,
            )
        )

    def _claim(self, corners: Array, reserved: bool) -> None:
        centre = corners.mean(0)
        self._circles.add(centre, float(np.linalg.norm(corners - centre, axis=1).max()))
        self._reserved.append(reserved)
        self._claims.append(corners)

    def _is_occupied(self, corners: Array, on_reserved: bool) -> bool:
        centre = corners.mean(0)
        return any(
            overlap(corners, self._claims[k])
            for k in self._circles.find_overlapping(
                centre, float(np.linalg.norm(corners[0] - centre))
            )
            if not (on_reserved and self._reserved[k])
        )


def _outline(corners: Array) -> Array:
    """Return points (20, 2) along the sides of a rectangle (4, 2)."""
    steps = np.linspace(0, 1, 5, endpoint=False)[:, None, None]
    return np.asarray((corners + steps * (np.roll(corners, -1, 0) - corners)).reshape(-1, 2))
