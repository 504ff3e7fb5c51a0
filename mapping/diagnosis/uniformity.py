"""How evenly the points of a map cover the ground its photographs see."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from scene.bundle.covisibility import surface_points
from scene.bundle.scene import Scene
from scene.maps.sparse_map import MapImage, SparseMap

# Ground counts as seen when so many photographs of the map, a point's least, have a pixel of a grid
# of so many a side in it.
_VIEWS = 2
_PER_SIDE = 64
# On a plane, rays that meet it farther away than so many times the camera's height (of depth) are
# of the horizon.
_FARTHEST = 5.0


@dataclass(frozen=True)
class Uniformity:
    """The spread of points over the cells of a grid seen from above.

    Attributes:
        cell_m: side of a cell.
        cells: those that two or more photographs of the map see.
        empty: share of them without a point.
        entropy: of the points' distribution over them, over the largest possible: 1 when all cells
            have as many, 0 when one has all.
    """

    cell_m: float
    cells: int
    empty: float
    entropy: float

    def text(self) -> str:
        """Return the figures as text."""
        return (
            f"{self.empty:.1%} of {self.cells} cells of {self.cell_m:g} m without a point, "
            f"entropy {self.entropy:.3f} of 1"
        )


def seen_cells(scene: Scene, sparse_map: SparseMap, cell_m: float) -> NDArray[np.int64]:
    """Cells that photographs of the map see, (C, 2) east and north in sides of a cell, by the
    scene's depth, or where it has none on the plane at the height of what each photograph observes.

    Raises:
        InputError: a file of the scene is damaged.
    """
    depths = {
        image.name: layers["depth"] for image, layers in scene.mapped_layers(sparse_map, "depth")
    }
    views: Counter[tuple[int, int]] = Counter()
    for image in sparse_map.images.values():
        if image.name in depths:
            camera, pose, depth = image.camera, image.cam_from_world, depths[image.name]
            surface = surface_points(camera, pose, depth, _PER_SIDE)
            surface = surface[np.isfinite(surface).all(1)]
        else:
            surface = _on_plane(image, sparse_map.xyz)
        views.update(set(_cells(surface, cell_m)))
    seen = [cell for cell, count in sorted(views.items()) if count >= _VIEWS]
    return np.array(seen, np.int64).reshape(-1, 2)


def uniformity(
    xyz: NDArray[np.float64], cells: NDArray[np.int64], cell_m: float
) -> Uniformity | None:
    """Measure how evenly points (M, 3) cover ``cells`` (C, 2); None where none is seen twice."""
    if not len(cells):
        return None
    held = Counter(_cells(xyz, cell_m))
    counts = np.array([held[(east, north)] for east, north in cells.tolist()])
    share = counts[counts > 0] / max(counts.sum(), 1)
    entropy = float(-(share * np.log(share)).sum() / np.log(len(cells))) if len(cells) > 1 else 1.0
    return Uniformity(cell_m, len(cells), float((counts == 0).mean()), entropy)


def _cells(points: NDArray[np.float64], cell_m: float) -> list[tuple[int, int]]:
    return [(e, n) for e, n in np.floor(points[:, :2] / cell_m).astype(int).tolist()]


def _on_plane(image: MapImage, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where rays on a grid of a photograph meet the height of its median point, (K, 3)."""
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
    met = np.isfinite(along) & (along > 0) & (along < _FARTHEST * abs(below))
    return np.asarray(image.centre + along[met, None] * directions[met])
