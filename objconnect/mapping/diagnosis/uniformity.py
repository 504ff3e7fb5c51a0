"""Measure how evenly the points of a map cover the ground that its photographs see."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.scene.bundle.covisibility import surface_points
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.maps.sparse_map import MapImage, SparseMap

# Minimum number of photographs that see a cell of the ground. A point needs two to be triangulated.
_MIN_VIEWS = 2
# Each photograph is sampled on a grid with this many pixels per side.
_PER_SIDE = 64
# Rays that meet the ground plane at a depth of more than this many times the camera's height above
# it are ignored, because they are near the horizon.
_MAX_CAMERA_HEIGHTS = 5.0


@dataclass(frozen=True)
class Uniformity:
    """The distribution of points over the cells of a horizontal grid.

    Attributes:
        cell_m: side of a cell, metres.
        cells: number of cells that two or more photographs of the map see.
        empty: share of these cells without a point.
        entropy: normalised entropy of the points over the cells: 1 if all cells have the same
            number of points, 0 if one cell has all.
    """

    cell_m: float
    cells: int
    empty: float
    entropy: float

    def text(self) -> str:
        """Return the statistics as text."""
        return (
            f"{self.empty:.1%} of {self.cells} cells of {self.cell_m:g} m without a point, "
            f"entropy {self.entropy:.3f} of 1"
        )


def visible_cells(scene: Scene, sparse_map: SparseMap, cell_m: float) -> NDArray[np.int64]:
    """Return the cells that at least two photographs of the map see, (C, 2).

    Cells are indices east and north. The surface is the scene's depth; for a photograph without
    depth it is the horizontal plane at the median height of the observed points.

    Raises:
        InputError: a file of the scene is damaged.
    """
    depths = {
        image.name: layers["depth"] for image, layers in scene.layers_of_map(sparse_map, "depth")
    }
    views: Counter[tuple[int, int]] = Counter()
    for image in sparse_map.images.values():
        if image.name in depths:
            camera, pose, depth = image.camera, image.cam_from_world, depths[image.name]
            surface = surface_points(camera, pose, depth, _PER_SIDE)
            surface = surface[np.isfinite(surface).all(1)]
        else:
            surface = _intersect_plane(image, sparse_map.xyz)
        views.update(set(_cells(surface, cell_m)))
    seen = [cell for cell, count in sorted(views.items()) if count >= _MIN_VIEWS]
    return np.array(seen, np.int64).reshape(-1, 2)


def uniformity(
    xyz: NDArray[np.float64], cells: NDArray[np.int64], cell_m: float
) -> Uniformity | None:
    """Measure how evenly points (M, 3) cover ``cells`` (C, 2); None without cells."""
    if not len(cells):
        return None
    points = Counter(_cells(xyz, cell_m))
    counts = np.array([points[(east, north)] for east, north in cells.tolist()])
    share = counts[counts > 0] / max(counts.sum(), 1)
    entropy = float(-(share * np.log(share)).sum() / np.log(len(cells))) if len(cells) > 1 else 1.0
    return Uniformity(cell_m, len(cells), float((counts == 0).mean()), entropy)


def _cells(points: NDArray[np.float64], cell_m: float) -> list[tuple[int, int]]:
    return [(e, n) for e, n in np.floor(points[:, :2] / cell_m).astype(int).tolist()]


def _intersect_plane(image: MapImage, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Intersect rays of a photograph with the plane at its points' median height, (K, 3)."""
    rows = image.point_rows[image.point_rows >= 0]
    if not len(rows):
        return np.zeros((0, 3))
    steps = (np.arange(_PER_SIDE) + 0.5) / _PER_SIDE
    grid = np.meshgrid(steps * image.camera.width, steps * image.camera.height)
    rays, valid = image.camera.unproject(torch.from_numpy(np.stack(grid, -1).reshape(-1, 2)))
    directions = rays[valid].numpy() @ image.cam_from_world[:3, :3]
    below = np.median(xyz[rows, 2]) - image.centre[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = below / directions[:, 2]
    meets_ground = np.isfinite(along) & (along > 0) & (along < _MAX_CAMERA_HEIGHTS * abs(below))
    return np.asarray(image.centre + along[meets_ground, None] * directions[meets_ground])
