"""Cast rays at the objects of a Blender scene."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulate.camera.resample import Cast
from simulate.render.stage import parse_object_name

# Objects whose box covers less of the picture than this (square px) may have parts thinner than a
# pixel, such as lamps.
_SMALL_PX2 = 1000.0


class Caster:
    """Casts rays at objects for ``simulate.camera.resample``.

    Args:
        objects: objects of Blender with updated matrices.
        near_m: near clipping distance, metres.
    """

    def __init__(self, objects: Iterable[Any], near_m: float) -> None:
        self._near_m = near_m
        # Matrices are stored, because objects that a frame does not need are moved away.
        self._objects: dict[int, list[tuple[Any, NDArray[np.float64]]]] = {}
        for item in objects:
            if item.type == "MESH":
                placed = item, np.array(item.matrix_world)
                self._objects.setdefault(parse_object_name(item.name), []).append(placed)
        items = [
            (object_id, placed[0]) for object_id, placed in self._objects.items() if object_id > 0
        ]
        self._ids = [object_id for object_id, _ in items]
        boxes = [np.insert(np.array(item.bound_box), 3, 1, axis=1) for _, (item, _) in items]
        self._corners = np.array(
            [box @ matrix.T for box, (_, (_, matrix)) in zip(boxes, items, strict=True)]
        ).reshape(-1, 8, 4)

    def small_object_boxes(
        self, cam_from_world: NDArray[np.float64], f: float
    ) -> dict[int, NDArray[np.float64]]:
        """Return the boxes (4,) of small objects by id: the least x and y, then the largest.

        The boxes are in image coordinates at depth 1, not in pixels. ``simulate.camera.resample``
        looks for parts of these objects between pixel centres.

        Args:
            cam_from_world: pose (4, 4).
            f: focal length, pixels.
        """
        x, y, z = np.moveaxis((self._corners @ cam_from_world.T)[..., :3], -1, 0)
        ahead = (z > self._near_m).all(-1)
        xy = np.stack([x, y], -1) / np.where(ahead[:, None], z, 1)[..., None]
        boxes = np.concatenate([xy.min(1), xy.max(1)], -1)
        area = f**2 * (boxes[:, 2:] - boxes[:, :2]).prod(-1)
        chosen = np.flatnonzero(ahead & (area < _SMALL_PX2))
        return {self._ids[k]: boxes[k] for k in chosen}

    def cast_from(self, cam_from_world: NDArray[np.float64]) -> Cast:
        """Return the function that casts rays of the camera at a pose."""
        world_from_cam = np.linalg.inv(cam_from_world)

        def cast(object_id: int, rays: NDArray[np.float64]) -> NDArray[np.float64]:
            nearest = np.full(len(rays), np.inf)
            ahead = np.concatenate([rays, np.ones_like(rays[:, :1])], -1)
            for item, world_from_local in self._objects[object_id]:
                local_from_cam = np.linalg.inv(world_from_local) @ world_from_cam
                origin = local_from_cam[:3, 3]
                directions = ahead @ local_from_cam[:3, :3].T
                start = origin.tolist()
                # Rays are plain lists, because a numpy call per ray is slower than the cast.
                results = [item.ray_cast(start, ray) for ray in directions.tolist()]
                hit = np.array([result[0] for result in results], bool)
                at = np.array([result[1][:] for result in results]).reshape(-1, 3)
                # The length in units of (x/z, y/z, 1) is the planar depth.
                z = ((at - origin) * directions).sum(-1) / np.square(directions).sum(-1)
                nearest = np.where(hit, np.minimum(nearest, z), nearest)
            return nearest

        return cast
