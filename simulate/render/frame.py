"""Steps of rendering a frame without Blender: rays, rolling shutter, labels and the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulate.camera.pinhole import PinholeCamera
from simulate.place.world import World, class_lookup


def exposure_offset(travel: NDArray[np.float64], height: int) -> NDArray[np.float64]:
    """Return the offset (3,), metres, that every row has in addition to ``row_shift``.

    Cycles exposes each row at the end of its readout, not in the middle as ``row_shift`` assumes.
    """
    return 0.5 * travel / height


def row_shift(travel: NDArray[np.float64], height: int) -> NDArray[np.float64]:
    """Return the camera's offset (height, 3), metres, at each row relative to the middle row.

    The camera moves by ``travel`` (3,) metres while a picture is read out.
    """
    return ((np.arange(height) + 0.5) / height - 0.5)[:, None] * travel


def pinhole_rays(camera: PinholeCamera) -> NDArray[np.float64]:
    """Return the rays x/z and y/z through every pixel centre, (H, W, 2)."""
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    return np.stack([(u - camera.cx) / camera.f, (v - camera.cy) / camera.f], -1)


def world_rays(
    rays: NDArray[np.float64], cam_from_world: NDArray[np.float64], shift: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the rays of pixels in the world: directions (H, W, 3) of depth 1, origins (H, 1, 3).

    The arguments are those of ``semantic_labels``; all lengths are metres.
    """
    ahead = np.concatenate([rays, np.ones_like(rays[..., :1])], -1)
    rotation, translation = cam_from_world[:3, :3], cam_from_world[:3, 3]
    return ahead @ rotation, (shift - translation @ rotation)[:, None]


def semantic_labels(
    world: World,
    rays: NDArray[np.float64],
    cam_from_world: NDArray[np.float64],
    shift: NDArray[np.float64],
    arrays: dict[str, NDArray[Any]],
) -> NDArray[np.uint8]:
    """Return the class of the object or ground at each pixel.

    Args:
        world: The place.
        rays: Rays x/z and y/z (H, W, 2) of the pixels, in camera coordinates.
        cam_from_world: Pose (4, 4) of the frame.
        shift: Offset (H, 3) of the camera from its pose at each row, world metres.
        arrays: The layers "depth" (H, W) in metres and "instance" (H, W).

    Returns:
        Labels (H, W).
    """
    depth, instance = arrays["depth"], arrays["instance"]
    ahead = np.concatenate([rays, np.ones_like(rays[..., :1])], -1)
    rotation, translation = cam_from_world[:3, :3], cam_from_world[:3, 3]
    points = (ahead * depth[..., None] - translation) @ rotation + shift[:, None]
    labels = class_lookup(world.objects)[instance]
    on_ground = (instance == 0) & (depth > 0)
    labels[on_ground] = world.ground.label(points[on_ground, 0], points[on_ground, 1])
    return np.asarray(labels)


def save_layers(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Write the layers of a frame atomically, so that ``path`` is always complete."""
    partial = path.with_suffix(".partial")
    with partial.open("wb") as file:
        np.savez(file, **arrays)
    partial.replace(path)
