"""Show the objects and lamps that a frame needs, and give the objects pass indices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from simulate.camera.pinhole import PinholeCamera
from simulate.look.conditions import Condition
from simulate.look.lamps import Beam
from simulate.place.world import MAX_OBJECT_ID, World
from simulate.render.reach import Reach, depth_inside

# In a world with more objects, unlinking objects is faster than moving them.
_MANY_OBJECTS: Final = 5000
_FAR_BELOW_M: Final = 1e7  # depth below the ground at which no ray meets an object


class Stage:
    """Removes the objects that a frame does not need, without changing its pixels.

    The class also switches off lamps too far away to light the view. Objects are moved far below
    the ground, which takes 0.2 ms each. In a world with many objects they are unlinked instead,
    after which Cycles reloads the scene in 0.4 s.

    Blender supports ``MAX_OBJECT_ID`` pass indices. Each object of the world has one; in a world
    with more objects, only the objects that the frame needs have one.

    Attributes:
        ids: ids (``MAX_OBJECT_ID`` + 1,) of the objects by pass index; 0 for none.

    Args:
        scene: Blender's scene, whose objects are named by ``object_name``.
        world: the world.
        condition: the condition.
        lamps: beams with their light data.
    """

    def __init__(
        self, scene: Any, world: World, condition: Condition, lamps: Sequence[tuple[Beam, Any]]
    ) -> None:
        self._reach = Reach(world.objects, condition.luminary.elevation)
        self._linked = scene.collection.objects
        self._objects = [self._linked[object_name(item.id)] for item in world.objects]
        self._object_ids = np.array([item.id for item in world.objects], np.int64)
        self._present = np.ones(len(self._objects), bool)
        self._unlinks = len(self._objects) > _MANY_OBJECTS
        self._lamps = lamps
        self.ids = np.zeros(MAX_OBJECT_ID + 1, np.int64)
        self._index = np.zeros(len(self._objects), np.int64)
        if len(self._objects) <= MAX_OBJECT_ID:
            for row in range(len(self._objects)):
                self._set_pass_index(row, row + 1)

    def set_up(
        self, camera: PinholeCamera, cam_from_world: NDArray[np.float64], travel_m: float
    ) -> None:
        """Restore the objects that a frame needs, and remove the others.

        Raises:
            InputError: the frame needs more objects than there are pass indices.
        """
        needed = self._reach(camera, cam_from_world, travel_m)
        for row in np.flatnonzero(needed != self._present):
            if self._unlinks:
                (self._linked.link if needed[row] else self._linked.unlink)(self._objects[row])
            else:
                self._objects[row].delta_location.z = 0.0 if needed[row] else -_FAR_BELOW_M
        self._present = needed
        if len(self._objects) > MAX_OBJECT_ID:
            self._assign_pass_indices(needed)
        positions = np.array([beam.position for beam, _ in self._lamps]).reshape(-1, 3)
        inside = depth_inside(positions, camera, cam_from_world) + travel_m
        for (beam, lamp), depth in zip(self._lamps, inside, strict=True):
            lamp.energy = beam.watts if depth > -beam.reach_m else 0.0

    def _assign_pass_indices(self, needed: NDArray[np.bool_]) -> None:
        """Give pass indices to all needed objects, and free those of the other objects."""
        if needed.sum() > MAX_OBJECT_ID:
            raise InputError(
                f"a photograph needs {needed.sum()} objects, more than {MAX_OBJECT_ID}: fly lower "
                "or look down more steeply"
            )
        self.ids[self._index[~needed]] = 0
        self._index[~needed] = 0
        free = iter(np.flatnonzero(self.ids[1:] == 0) + 1)
        for row in np.flatnonzero(needed & (self._index == 0)):
            self._set_pass_index(row, int(next(free)))

    def _set_pass_index(self, row: int, index: int) -> None:
        self._objects[row].pass_index = index
        self._index[row], self.ids[index] = index, self._object_ids[row]


def object_name(object_id: int) -> str:
    """Return the name of an object in Blender. Names of ascending ids are fast to insert."""
    return f"{object_id:05d}"


def parse_object_name(name: str) -> int:
    """Return the id of the object with a name in Blender; 0 for the ground and others."""
    return int(name) if name.isdecimal() else 0
