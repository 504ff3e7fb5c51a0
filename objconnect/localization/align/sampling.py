"""Bilinear interpolation of feature maps and of their slopes.

Cell (row i, column j) of a map of stride s is centred on pixel ((j + 0.5) s, (i + 0.5) s), in
COLMAP's pixels. Coordinates in cells have that centre at (j, i).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

Stride = float | tuple[float, float]
"""Pixels per cell: one number, or x and y for a picture resized by two factors."""


def per_axis(stride: Stride, like: Tensor) -> Tensor:
    """Return the stride in x and y, (2,), with the dtype and device of another tensor."""
    both = stride if isinstance(stride, tuple) else (stride, stride)
    return torch.tensor(both, dtype=like.dtype, device=like.device)


def inside(cells: Tensor, width: int, height: int, border: float) -> Tensor:
    """Return whether cells (..., 2) are at least ``border`` inside the outermost cell centres."""
    last = torch.tensor([width - 1 - border, height - 1 - border], device=cells.device)
    return ((cells >= border) & (cells <= last)).all(-1)


@dataclass(frozen=True)
class CellTable:
    """Maps of a batch as one table of cells, which any number of points share.

    Attributes:
        cells: (B h w, C) in any floating type; a view where the map is channels-last in memory.
    """

    cells: Tensor
    width: int
    height: int

    @staticmethod
    def of(maps: Tensor) -> CellTable:
        """Build the table of maps (B, C, h, w)."""
        _, channels, height, width = maps.shape
        return CellTable(maps.permute(0, 2, 3, 1).reshape(-1, channels), width, height)

    def first(self, owner: Tensor) -> Tensor:
        """Return the number of the first cell of each map of ``owner``."""
        return owner * (self.width * self.height)

    def gather(self, index: Tensor) -> Tensor:
        """Return cells (..., k, C) by number (..., k), at least in single precision."""
        cells = self.cells.index_select(0, index.flatten()).view(*index.shape, self.cells.shape[-1])
        return cells if cells.dtype == torch.float64 else cells.float()

    def mix(self, index: Tensor, weights: Tensor) -> Tensor:
        """Return value and slopes (M, N, 3, C) by cells and weights (M, N, 20) of ``stencil``.

        One pass that gathers and sums takes a tenth of the time of a product with the gathered
        cells, which exceed the processor's cache.
        """
        shape, index = index.shape[:-1], index.flatten()
        parts = torch.tensor(_PARTS, device=index.device)
        begin = torch.arange(0, len(index), STENCIL, device=index.device)[:, None] + parts
        share = weights.to(self.cells).flatten()
        mixed = embedding_bag(
            index, self.cells, begin.flatten(), mode="sum", per_sample_weights=share
        )
        return mixed.view(*shape, 3, self.cells.shape[-1])

    def value(self, index: Tensor, weights: Tensor) -> Tensor:
        """Return the value (M, N, C) by cells and weights (M, N, 20) of ``stencil``."""
        cells, share = index[..., :VALUE].flatten(0, -2), weights[..., :VALUE].flatten(0, -2)
        value = embedding_bag(
            cells, self.cells, mode="sum", per_sample_weights=share.to(self.cells)
        )
        return value.view(*index.shape[:-1], self.cells.shape[-1])


def _stencil_basis() -> tuple[list[tuple[int, int]], Tensor]:
    """Return the stencil's cells (x, y), and the (4, 20) matrix from 1, a, b, ab to weights."""
    two, four = (0, 1), range(-1, 3)
    reach = ((two, two), (two, four), (four, two))  # rows and columns of each part
    placed = [
        (part, x, y) for part, (rows, columns) in enumerate(reach) for y in rows for x in columns
    ]

    def weights(a: float, b: float) -> Tensor:
        value = [torch.tensor([0, 1 - t, t, 0]) for t in (a, b)]
        slope = [0.5 * torch.tensor([t - 1, -t, 1 - t, t]) for t in (a, b)]
        columns = (value[0], slope[0], value[0])
        rows = (value[1], value[1], slope[1])
        return torch.stack([rows[part][y + 1] * columns[part][x + 1] for part, x, y in placed])

    at = {(a, b): weights(a, b).double() for a in (0.0, 1.0) for b in (0.0, 1.0)}
    none, x, y, both = at[0, 0], at[1, 0], at[0, 1], at[1, 1]
    return [(x, y) for _, x, y in placed], torch.stack(
        [none, x - none, y - none, both - x - y + none]
    )


# Cells of a bilinear value (4), its central difference along x (8) and along y (8). Weights are
# bilinear in the position (a, b) between cells.
_CELLS, _BASIS = _stencil_basis()
STENCIL: Final = len(_CELLS)
VALUE: Final = 4
_PARTS: Final = (0, VALUE, 12)


def stencil(cells: Tensor, table: CellTable, first: Tensor) -> tuple[Tensor, Tensor]:
    """Return the cells and weights of a bilinear value and its central differences.

    Args:
        cells: (M, N, 2), at least one cell from the border.
        table: table of the maps.
        first: (M,) number of the first cell of each row's map.

    Returns:
        Cell numbers (M, N, 20) and their weights (M, N, 20): four cells of the value, eight of its
        slope along x and eight of its slope along y, per cell. A slope is half the difference of
        the values one cell before and one cell after.
    """
    last = torch.tensor([table.width - 3, table.height - 3], device=cells.device)
    corner = cells.detach().floor().clamp_min(1).minimum(last)
    between = cells - corner
    powers = torch.cat([torch.ones_like(between[..., :1]), between, between.prod(-1, True)], -1)
    weights = powers @ _BASIS.to(cells)
    x, y = corner.long().unbind(-1)
    steps = torch.tensor([y * table.width + x for x, y in _CELLS], device=cells.device)
    index = (first[:, None] + y * table.width + x)[..., None] + steps
    return index.clamp_(0, len(table.cells) - 1), weights


def sample(maps: Tensor, xy: Tensor, stride: Stride, border: float = 0) -> tuple[Tensor, Tensor]:
    """Sample maps bilinearly at pixels.

    Args:
        maps: (B, C, h, w).
        xy: (B, N, 2) pixels, finite or not.
        stride: pixels per cell.
        border: cells; points nearer to the edge do not count as inside.

    Returns:
        Values (B, N, C), arbitrary for points outside, and whether points are inside (B, N).

    Example:
        Cells are centred on half pixels, so pixel 1.0 lies between the first two cells:

        >>> maps = torch.tensor([[[[0.0, 1.0, 2.0]]]])
        >>> values, inside = sample(maps, torch.tensor([[[1.0, 0.5], [5.0, 0.5]]]), stride=1.0)
        >>> values[0, 0].tolist(), inside.tolist()
        ([0.5], [[True, False]])
    """
    table = CellTable.of(maps)
    cells = xy / per_axis(stride, xy) - 0.5
    seen = inside(cells, table.width, table.height, max(border, 0))
    cells = torch.where(seen[..., None], cells, 0)
    corner = cells.detach().floor()
    a, b = (cells - corner).unbind(-1)
    x, y = corner.long().unbind(-1)
    right, below = (x + 1).clamp_max(table.width - 1), (y + 1).clamp_max(table.height - 1)
    first = table.first(torch.arange(len(maps), device=maps.device))[:, None]
    index = torch.stack([v * table.width + u for v in (y, below) for u in (x, right)], -1)
    weights = torch.stack([v * u for v in (1 - b, b) for u in (1 - a, a)], -1)
    values = table.gather(first[..., None] + index)
    return (weights[..., None, :].to(values.dtype) @ values)[..., 0, :], seen
