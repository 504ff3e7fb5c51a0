"""Find the ground that the map photographs of a real site see, and sample colours of points.

Occlusion is not tested, because a site has no exact heights.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.scene import Scene
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.images import read_rgb

Array = NDArray[np.float64]

_POINTS_AT_ONCE: Final = 1 << 20  # points that are projected together
# Minimum number of photographs that must see a point of the ground, so that its height can be
# triangulated, and maximum share of a covered square that fewer see.
_MIN_VIEWS: Final = 2
_MAX_UNSEEN_SHARE: Final = 0.05
_GRID_CELLS: Final = 256  # cells along a side of the grid on which views are counted


class Photograph(NamedTuple):
    """A photograph of the map, with its pose ``cam_from_world`` (4, 4)."""

    path: Path
    camera: Camera
    cam_from_world: Array

    @property
    def centre(self) -> Array:
        """Return the camera centre, (3,) metres."""
        return np.asarray(-self.cam_from_world[:3, :3].T @ self.cam_from_world[:3, 3])

    def project(self, points: Array) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Project world points (N, 3) to pixels (N, 2), and return which lie in the picture."""
        import torch

        pixels, seen = [], []
        for k in range(0, len(points), _POINTS_AT_ONCE):
            local = points[k : k + _POINTS_AT_ONCE] @ self.cam_from_world[:3, :3].T
            projected = self.camera.project(torch.from_numpy(local + self.cam_from_world[:3, 3]))
            inside = projected.valid & self.camera.contains(projected.xy)
            pixels.append(projected.xy.numpy().astype(np.float32))
            seen.append(inside.numpy())
        return np.concatenate(pixels), np.concatenate(seen)


def map_photographs(scene: Scene) -> list[Photograph]:
    """Return the photographs of a scene's map.

    Raises:
        InputError: A list of frames is damaged.
    """
    mapped = set(scene.splits.map)
    return [
        Photograph(scene.images_root / name, frames.cameras[k], frames.cam_from_world[k])
        for frames in map(scene.frames, scene.sessions)
        for k, name in enumerate(frames.names)
        if name in mapped
    ]


def covered_square(photographs: Sequence[Photograph], height: float, max_side_m: float) -> float:
    """Return the side of the largest square around the origin that at least two photographs see.

    At most 5 % of the square may be seen by fewer photographs.

    Args:
        photographs: The photographs of the map.
        height: Height of the ground, metres above the origin.
        max_side_m: Maximum side, metres.

    Returns:
        The side in metres; 0 where the origin was not photographed.
    """
    axis = (np.arange(_GRID_CELLS) + 0.5) / _GRID_CELLS - 0.5
    x, y = (max_side_m * grid.ravel() for grid in np.meshgrid(axis, axis))
    ground = np.stack([x, y, np.full(len(x), height)], -1)
    views = np.zeros(len(ground), int)
    for photograph in photographs:
        views += photograph.project(ground)[1]
    # Side of the square on whose edge each point lies, sorted from the centre outwards.
    sides = 2 * np.maximum(abs(x), abs(y))
    order = np.argsort(sides, kind="stable")
    unseen_share = np.cumsum(views[order] < _MIN_VIEWS) / np.arange(1, len(order) + 1)
    good = np.nonzero(unseen_share <= _MAX_UNSEEN_SHARE)[0]
    return float(sides[order][good[-1]]) if len(good) else 0.0


def sample_photographs(photographs: Sequence[Photograph], points: Array) -> NDArray[np.float32]:
    """Return the colours of world points, each from the photograph that sees it most steeply.

    Args:
        photographs: The photographs of the map.
        points: (N, 3) metres.

    Returns:
        Colours (N, 3) in 0..255, NaN where no photograph sees the point.

    Raises:
        InputError: A photograph is missing or damaged.
    """
    colours = np.full((len(points), 3), np.nan, np.float32)
    best = np.zeros(len(points))
    with progress_bar("colours of photographs", len(photographs)) as advance:
        for count, photograph in enumerate(photographs, 1):
            pixels, seen = photograph.project(points)
            ray = points - photograph.centre
            down = -ray[:, 2] / np.linalg.norm(ray, axis=1)
            better = np.nonzero(seen & (down > best))[0]
            if len(better):
                rgb = read_rgb(photograph.path, photograph.camera)
                best[better] = down[better]
                colours[better] = _interpolate(rgb, pixels[better])
            advance(count)
    return colours


def _interpolate(rgb: NDArray[np.uint8], pixels: NDArray[np.float32]) -> NDArray[np.float32]:
    """Interpolate a picture (H, W, 3) at COLMAP pixels (N, 2)."""
    parts = []
    for k in range(0, len(pixels), 1 << 14):  # OpenCV accepts at most 2^15 rows
        x, y = (pixels[k : k + (1 << 14)] - 0.5).T
        at = cv2.remap(
            rgb, x[:, None], y[:, None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        parts.append(at.reshape(-1, 3))
    return np.asarray(np.concatenate(parts), np.float32)
