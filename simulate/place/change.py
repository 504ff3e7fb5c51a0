"""Change a place between flights: vehicles moved, objects removed or added, bare trees.

Conditions do not change the geometry. Every difference from the original place is configured by a
``Change`` and recorded object by object.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from objconnect.scene.bundle.labels import CLASSES
from objconnect.scene.bundle.manifest import DeclaredChange
from objconnect.scene.config import Config
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.rectangle import overlap, rectangle
from simulate.place.grid import CircleGrid
from simulate.place.kerbs import PavementHeights
from simulate.place.world import MAX_OBJECT_ID, World, WorldObject, rise, slope_under

Array = NDArray[np.float64]

VEHICLES = ("car", "van", "truck")
"""Classes of objects that a change can move."""
LOOSE = (*VEHICLES, "tractor", "container", "bench", "bin", "table", "pallet", "bale")
"""Classes of objects that a change can remove or add."""

_LEAFY_PREFIX, _BARE_PREFIX = "broadleaf_", "bare_"  # prefixes of the shapes of trees
_BAY_M = 2.6  # distance between the middles of vehicles side by side
_GAP_M = 0.3  # free space around a moved or added object, per side
_TRIES = 60  # random positions that are tried for each object


class Change(Config):
    """The difference between the world of a session (flight) and the original place.

    Sessions with equal changes show the same world.
    """

    cars_moved: float = Field(
        0.0,
        ge=0,
        le=1,
        description="Share of the remaining cars, vans and trucks that are moved, where there is "
        "room, 0 to 1.",
    )
    objects_removed: float = Field(
        0.0,
        ge=0,
        le=1,
        description="Share of the vehicles, containers and small loose objects that are removed, "
        "0 to 1.",
    )
    objects_added: float = Field(
        0.0,
        ge=0,
        le=1,
        description="Number of new vehicles, containers and small loose objects, as a share "
        "(0 to 1) of the original ones, where there is room.",
    )
    bare_trees: bool = Field(
        False, description="Whether broadleaved trees have no leaves, as in leaf-off seasons."
    )
    seed: int = Field(0, ge=0, description="Random seed of the choice of objects.")


@dataclass(frozen=True)
class ChangedWorld:
    """A world after a change.

    Attributes:
        first_new_id: the first id of its moved and added objects.
        declared: ids of the objects that were moved, removed, added or lost their leaves.
    """

    world: World
    change: Change
    first_new_id: int
    declared: DeclaredChange


def change_worlds(base: World, changes: Iterable[Change]) -> list[ChangedWorld]:
    """Return the world after each change. An id means the same object in all of them.

    Raises:
        InputError: as ``change_world``.
    """
    known: dict[Change, ChangedWorld] = {}
    worlds = []
    free_id = _free_id(base)
    for change in changes:
        if change not in known:
            known[change] = change_world(base, change, free_id)
            free_id = max(free_id, _free_id(known[change].world))
        worlds.append(known[change])
    return worlds


def list_objects(base: World, worlds: Iterable[ChangedWorld]) -> tuple[WorldObject, ...]:
    """Return the objects of the base world and of all changes, by ascending id."""
    objects = {o.id: o for o in base.objects}
    for changed in worlds:
        for item in changed.world.objects:
            objects.setdefault(item.id, item)
    return tuple(objects[number] for number in sorted(objects))


def change_world(base: World, change: Change, first_new_id: int = 0) -> ChangedWorld:
    """Return the world after a change. Equal arguments give equal worlds.

    Unchanged objects keep their id and box. Moved and added objects get new ids, counted from
    ``first_new_id`` or from the first free id of ``base``, whichever is larger.

    Raises:
        InputError: there are more objects than a renderer can number.
    """
    first_new_id = max(first_new_id, _free_id(base))
    rng = np.random.default_rng([base.seed, 3, change.seed])
    loose = [o for o in base.objects if o.class_name in LOOSE]
    order = [loose[i] for i in rng.permutation(len(loose))]
    removed = order[: round(change.objects_removed * len(loose))]
    staying = [o for o in order[len(removed) :] if o.class_name in VEHICLES]
    moving = staying[: round(change.cars_moved * len(staying))]
    absent = {o.id for o in (*removed, *moving)}
    positions = _FreePositions(base, rng)
    placed: list[WorldObject] = []
    moved = []
    for item in moving:
        new = positions.find(item, first_new_id + len(placed))
        if new is None:
            absent.remove(item.id)  # there is no room anywhere, so it stays
        else:
            placed.append(new)
            moved.append((item.id, new.id))
    added = []
    for _ in range(round(change.objects_added * len(loose))):
        original = loose[int(rng.integers(len(loose)))]
        new = positions.find(original, first_new_id + len(placed))
        if new is not None:
            placed.append(new)
            added.append(new.id)
    if placed and placed[-1].id > MAX_OBJECT_ID:
        raise InputError(
            f"the changes of all sessions bring more than {MAX_OBJECT_ID} objects: lower "
            "cars_moved or objects_added, or make the area smaller"
        )
    objects = [*(o for o in base.objects if o.id not in absent), *placed]
    bare = []
    if change.bare_trees:
        bare = [k for k, o in enumerate(objects) if o.shape.startswith(_LEAFY_PREFIX)]
    for k in bare:
        shape = objects[k].shape.replace(_LEAFY_PREFIX, _BARE_PREFIX)
        objects[k] = replace(objects[k], shape=shape)
    declared = DeclaredChange(
        moved=tuple(sorted(moved)),
        removed=tuple(sorted(o.id for o in removed)),
        added=tuple(added),
        bare=tuple(objects[k].id for k in bare),
    )
    return ChangedWorld(replace(base, objects=tuple(objects)), change, first_new_id, declared)


def _free_id(world: World) -> int:
    return max((o.id for o in world.objects), default=0) + 1


def _kind(item: WorldObject) -> str:
    """Return the group of objects that may stand beside each other: a class, or vehicles."""
    return "vehicle" if item.class_name in VEHICLES else item.class_name


class _FreePositions:
    """Finds free positions for objects beside others of their kind, on the same class of ground.

    Original positions stay occupied, so that an object without a new position can stay.
    """

    def __init__(self, base: World, rng: np.random.Generator) -> None:
        self._base = base
        self._pavements = PavementHeights(base.kerbs)
        self._rng = rng
        self._taken: list[Array] = []
        self._circles = CircleGrid()
        self._by_kind: dict[str, list[WorldObject]] = {}
        for item in base.objects:
            self._take(item.footprint())
            self._by_kind.setdefault(_kind(item), []).append(item)

    def find(self, item: WorldObject, new_id: int) -> WorldObject | None:
        """Return a copy of an object at a free position with a new id; None without one."""
        similar = self._by_kind[_kind(item)]
        for _ in range(_TRIES):
            neighbour = similar[int(self._rng.integers(len(similar)))]
            position = neighbour.centre[:2] + self._step(neighbour)
            if not self._fits(position, item, neighbour):
                continue
            corners = rectangle(position, item.size[:2], neighbour.yaw)
            self._take(corners)
            ground = float(self._base.terrain.height(*position))
            ground += self._pavements.height_at(position)
            centre = np.array([position[0], position[1], ground + 0.5 * item.height_m])
            driven = neighbour.driven
            new = replace(item, id=new_id, centre=centre, yaw=neighbour.yaw, driven=driven)
            return new if item.slope is None else self._lean(new, corners)
        return None

    def _lean(self, item: WorldObject, corners: Array) -> WorldObject:
        """Return a moved object that leans with the ground under its corners (4, 2)."""
        slope = slope_under(self._base.terrain, corners)
        size = np.array([*item.size[:2], item.height_m + rise(slope, item.size)])
        return replace(item, size=size, slope=slope)

    def _step(self, neighbour: WorldObject) -> Array:
        """Draw an offset (2,), metres, from an object to a similar position."""
        ahead = np.array([np.cos(neighbour.yaw), np.sin(neighbour.yaw)])
        left = np.array([-ahead[1], ahead[0]])
        sign = 1 if self._rng.random() < 0.5 else -1
        if neighbour.class_name not in VEHICLES:
            angle = self._rng.uniform(0, 2 * np.pi)
            return np.asarray(
                self._rng.uniform(3, 15) * (np.cos(angle) * ahead + np.sin(angle) * left)
            )
        if self._label(neighbour.centre[None, :2])[0] == CLASSES["road"]:
            return np.asarray(sign * self._rng.uniform(7, 25) * ahead)
        bays = int(self._rng.integers(1, 5))
        return np.asarray(sign * bays * _BAY_M * left)

    def _fits(self, position: Array, item: WorldObject, neighbour: WorldObject) -> bool:
        """Return whether an object fits at a position.

        The object must lie inside the area, only on the neighbour's class of ground, and clear of
        other objects.
        """
        grown = rectangle(position, item.size[:2] + 2 * _GAP_M, neighbour.yaw)
        if np.abs(grown).max() > 0.5 * self._base.side_m:
            return False
        under = np.vstack([grown, 0.5 * (grown + np.roll(grown, 1, 0)), position])
        if (self._label(under) != self._label(neighbour.centre[None, :2])).any():
            return False
        near = self._circles.find_overlapping(position, float(np.linalg.norm(grown[0] - position)))
        return not any(overlap(grown, self._taken[k]) for k in near)

    def _take(self, corners: Array) -> None:
        centre = corners.mean(0)
        self._circles.add(centre, float(np.linalg.norm(corners[0] - centre)))
        self._taken.append(corners)

    def _label(self, points: Array) -> NDArray[np.uint8]:
        return self._base.ground.label(points[:, 0], points[:, 1])
