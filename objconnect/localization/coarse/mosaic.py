"""The mosaic of a map: features of every cell of the ground, seen from above."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import avg_pool2d, max_pool2d, normalize, pad

from objconnect.localization.coarse.grid import GroundGrid
from objconnect.localization.featuremetric.maps import FeatureMap
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import WarpedImage, looks_down
from objconnect.scene.maps.sparse_map import MapImage, SparseMap

Extract = Callable[[MapImage], tuple[WarpedImage, FeatureMap]]


@dataclass(frozen=True)
class Mosaic:
    """Coarse features of the cells of the ground, less their mean, in principal components.

    Attributes:
        grid: the H x W cells of the ground.
        features: (K, H, W) float32 of unit length, 0 in unknown cells.
        known: (H, W) float32, 1 where a photograph shows the cell, else 0.
        mean: (C,) mean of the network's features, weighted by confidence.
        components: (C, K) orthonormal principal components.
    """

    ARRAYS: ClassVar = ("origin", "cell", "heights", "features", "known", "mean", "components")

    grid: GroundGrid
    features: Tensor
    known: Tensor
    mean: Tensor
    components: Tensor

    def reduce_channels(self, features: Tensor) -> Tensor:
        """Project features (1, C, h, w) of a view to the mosaic's components, (1, K, h, w)."""
        cells = torch.nn.functional.normalize(features[0].float(), dim=0).permute(1, 2, 0)
        reduced = torch.nn.functional.normalize((cells - self.mean) @ self.components, dim=-1)
        return reduced.permute(2, 0, 1)[None]

    def halve(self) -> Mosaic:
        """Return the mosaic with cells of twice the side, each the mean of four."""
        north, east = (side % 2 for side in self.grid.shape)
        features = pad(self.features, (0, east, 0, north))
        known = pad(self.known, (0, east, 0, north))[None]
        heights = np.pad(self.grid.heights, ((0, north), (0, east)), mode="edge")
        return Mosaic(
            GroundGrid(self.grid.origin, 2 * self.grid.cell, heights[::2, ::2]),
            normalize(avg_pool2d(features, 2), dim=0),
            max_pool2d(known, 2)[0],
            self.mean,
            self.components,
        )

    @property
    def is_empty(self) -> bool:
        """Return whether no photograph of the map looks down."""
        return not bool(self.known.any())

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the fields by the names of ``ARRAYS``, features in half precision."""
        grid, values = self.grid, (self.features.half(), self.known, self.mean, self.components)
        arrays = (
            grid.origin,
            np.array([grid.cell]),
            grid.heights,
            *(v.cpu().numpy() for v in values),
        )
        return dict(zip(self.ARRAYS, arrays, strict=True))

    @staticmethod
    def of(arrays: Mapping[str, NDArray[Any]]) -> Mosaic:
        """Return a mosaic from the result of ``arrays``."""
        origin, cell, heights, *rest = (arrays[name] for name in Mosaic.ARRAYS)
        features, known, mean, components = (torch.from_numpy(each).float() for each in rest)
        grid = GroundGrid(origin, float(cell[0]), heights)
        return Mosaic(grid, features, known, mean, components)

    def to(self, device: torch.device) -> Mosaic:
        """Return the mosaic on a device."""
        tensors = (self.features, self.known, self.mean, self.components)
        return Mosaic(self.grid, *(each.to(device) for each in tensors))


def empty_mosaic(grid: GroundGrid) -> Mosaic:
    """Return a mosaic without a known cell."""
    nothing = torch.zeros(grid.shape)
    return Mosaic(grid, nothing[None], nothing, torch.zeros(1), torch.ones(1, 1))


@torch.inference_mode()
def make_mosaic(
    sparse_map: SparseMap,
    grid: GroundGrid,
    channels: int,
    extract: Extract,
    advance: Callable[[int], None],
) -> Mosaic:
    """Average the coarse features of all photographs that look down, cell by cell.

    Features are summed on the CPU, whatever device computed them.

    Args:
        sparse_map: the map.
        grid: the cells of the ground.
        channels: maximum number K of principal components.
        extract: warps a photograph north up, resizes it to the same resolution as all others, and
            computes the features of the coarsest level.
        advance: called with the number of photographs done.

    Raises:
        InputError: a photograph is missing or broken.
    """
    cells = torch.from_numpy(grid.centres().reshape(-1, 3))
    total: Tensor | None = None
    weight = torch.zeros(len(cells))
    for done, name in enumerate(sparse_map.names, 1):
        image = sparse_map.images[name]
        if looks_down(image.cam_from_world[:3, :3]):
            view, level = extract(image)
            rows, features, confidence = _visible_cells(view, level, image.pose, cells)
            if total is None:
                total = torch.zeros(len(cells), features.shape[1])
            total[rows] += confidence[:, None] * features
            weight[rows] += confidence
        advance(done)
    known = weight > 0
    shape = grid.shape
    if total is None or not bool(known.any()):
        return empty_mosaic(grid)
    mean = total.sum(0) / weight.sum()
    centred = torch.nn.functional.normalize(total[known] / weight[known, None] - mean, dim=1)
    _, vectors = torch.linalg.eigh(centred.T @ centred)
    components = vectors.flip(1)[:, :channels].contiguous()
    features = torch.zeros(len(cells), components.shape[1])
    features[known] = torch.nn.functional.normalize(centred @ components, dim=1)
    placed = features.T.reshape(-1, *shape).contiguous()
    return Mosaic(grid, placed, known.float().reshape(shape), mean, components)


def _visible_cells(
    view: WarpedImage, level: FeatureMap, pose: Pose, cells: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return which of the cells (M, 3) a photograph shows: their rows (N,), unit features (N, C)
    and confidences (N,)."""
    projected = view.camera.project(view.pose(pose).transform(cells))
    inside = projected.valid & view.camera.contains(projected.xy)
    rows = torch.nonzero(inside)[:, 0]
    xy = projected.xy[rows]
    shown = torch.from_numpy(view.shows(xy.numpy()))
    rows, xy = rows[shown], xy[shown]
    features, confidence = level.sample(xy.float())
    return rows, features.cpu(), confidence.cpu()
