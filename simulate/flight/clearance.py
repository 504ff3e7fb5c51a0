"""Refuse flights through obstacles, and photographs that do not show the rendered area."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from simulate.flight.gimbal import camera_centres
from simulate.place.world import World

Array = NDArray[np.float64]

# Least distance (m) of a camera to the ground and to the boxes of objects.
_CLEARANCE_M = 0.3
# Number of lines of sight that are tested, per side of a photograph.
_RAYS = 17


def check_flight(name: str, cam_from_world: Array, camera: Camera, world: World) -> None:
    """Check that a flight is clear of obstacles and that every photograph shows the place.

    Args:
        name: Name of the session, for the error message.
        cam_from_world: Poses (N, 4, 4).
        camera: The camera of the photographs.
        world: The rendered place with its terrain and objects.

    Raises:
        InputError: A camera is under the ground, in or under an object's box, or sees nothing of
            the place.
    """
    centres = camera_centres(cam_from_world)
    missing_m = _missing_clearance(centres, world)
    if (missing_m > 0).any():
        k = int(missing_m.argmax())
        raise InputError(
            f"session {name}: photograph {k} is {missing_m[k]:.1f} m below the minimum clearance "
            "above the ground: fly higher"
        )
    blocking = find_blocking(centres, world)
    if blocking.any():
        k = int(np.flatnonzero(blocking)[0])
        item = next(item for item in world.objects if item.id == blocking[k])
        x, y, _ = centres[k]
        top = item.centre[2] + 0.5 * item.size[2] - float(world.terrain.height(x, y))
        raise InputError(
            f"session {name}: photograph {k} is in or under {item.class_name} {item.id} at "
            f"({x:.0f}, {y:.0f}) m: fly higher than {top:.1f} m there, or elsewhere"
        )
    seen = _sees_place(cam_from_world, centres, camera, world)
    if not seen.all():
        k = int(np.flatnonzero(~seen)[0])
        x, y, _ = centres[k]
        raise InputError(
            f"session {name}: photograph {k} at ({x:.0f}, {y:.0f}) m does not show the place, "
            f"a square of {world.side_m:g} m around the origin: fly nearer or look down"
        )


def is_free(centres: Array, world: World) -> NDArray[np.bool_]:
    """Return whether each of the positions (N, 3) is inside the place and clear of obstacles."""
    inside = (np.abs(centres[:, :2]) <= 0.5 * world.side_m).all(1)
    free: NDArray[np.bool_] = inside & (_missing_clearance(centres, world) <= 0)
    free[free] = find_blocking(centres[free], world) == 0
    return free


def find_blocking(centres: Array, world: World) -> NDArray[np.int64]:
    """Return the id of the object whose box each position (N, 3) is in or under; 0 if none."""
    blocking = np.zeros(len(centres), np.int64)
    for item in world.objects:
        offset = centres - item.centre
        cos, sin = np.cos(item.yaw), np.sin(item.yaw)
        along = np.abs(cos * offset[:, 0] + sin * offset[:, 1])
        aside = np.abs(cos * offset[:, 1] - sin * offset[:, 0])
        half = 0.5 * item.size + _CLEARANCE_M
        inside = (along < half[0]) & (aside < half[1]) & (offset[:, 2] < half[2])
        blocking[inside] = item.id
    return blocking


def _missing_clearance(centres: Array, world: World) -> Array:
    """Return by how much each position is below the minimum clearance (m); negative above it."""
    ground = world.terrain.height(centres[:, 0], centres[:, 1])
    return np.asarray(ground + _CLEARANCE_M - centres[:, 2])


def _sees_place(cam_from_world: Array, centres: Array, camera: Camera, world: World) -> Array:
    """Return whether any line of sight of each pose meets the box around the place, (N,)."""
    size = np.array([camera.width, camera.height], float)
    share = np.stack(np.meshgrid(*[np.linspace(0, 1, _RAYS)] * 2), -1).reshape(-1, 2)
    local = np.column_stack([(share * size - camera.principal) / camera.focal, np.ones(_RAYS**2)])
    ray = np.einsum("nji,rj->nri", cam_from_world[:, :3, :3], local)
    ray = np.where(np.abs(ray) < 1e-12, 1e-12, ray)
    tops = [item.centre[2] + 0.5 * item.size[2] for item in world.objects]
    half = 0.5 * world.side_m
    low = np.array([-half, -half, world.terrain.nodes.min() - 1])
    high = np.array([half, half, max([world.terrain.nodes.max(), *tops])])
    # Slab method: a ray is inside the box between its last entry and its first exit.
    a, b = ((edge - centres[:, None]) / ray for edge in (low, high))
    entry, leave = np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)
    return np.asarray((leave >= np.maximum(entry, 0)).any(1))
