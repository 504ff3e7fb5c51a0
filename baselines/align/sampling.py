"""Features between the cells of a map, and their slopes.

Cell (row i, column j) of a map of stride s is centred on pixel ((j + 0.5) s, (i + 0.5) s), in
COLMAP's pixels. "Cells" below are coordinates in which that centre is (j, i).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

Stride = float | tuple[float, float]
"""Pixels per cell, one number or x and y (a picture resized by two factors)."""

# Column and row of the twelve cells that a value and its central differences are made of: a square
# of 4 x 4 cells, from -1 to 2, without its corners.
_SQUARE = [(x, y) for y in range(-1, 3) for x in range(-1, 3)]
_USED = [k for k, (x, y) in enumerate(_SQUARE) if x in (0, 1) or y in (0, 1)]


def to_cells(xy: Tensor, stride: Stride) -> Tensor:
    """Pixels (..., 2) in cells."""
    return xy / per_axis(stride, xy) - 0.5


def per_axis(stride: Stride, like: Tensor) -> Tensor:
    """The stride in x and y, (2,), with the dtype and device of another tensor."""
    both = stride if isinstance(stride, tuple) else (stride, stride)
    return torch.tensor(both, dtype=like.dtype, device=like.device)


def inside(cells: Tensor, width: int, height: int, border: float) -> Tensor:
    """Whether cells (..., 2) are at least ``border`` away from the centres of the outermost."""
    x, y = cells.unbind(-1)
    return (x >= border) & (x <= width - 1 - border) & (y >= border) & (y <= height - 1 - border)


@dataclass(frozen=True)
class CellTable:
    """Maps of a batch as one table of cells, so that any number of points can share them.

    Attributes:
        rows: (B h w, C) in any floating type; a view where the map is channels-last in memory.
        width: cells.
        height: cells.
    """

    rows: Tensor
    width: int
    height: int

    @staticmethod
    def of(maps: Tensor) -> CellTable:
        """From maps (B, C, h, w)."""
        _, channels, height, width = maps.shape
        return CellTable(maps.permute(0, 2, 3, 1).reshape(-1, channels), width, height)

    def gather(self, index: Tensor) -> Tensor:
        """Cells by number (..., k), at least in single precision. -> (..., k, C)."""
        rows = self.rows.index_select(0, index.flatten()).view(*index.shape, -1)
        return rows if rows.dtype == torch.float64 else rows.float()


def stencil(cells: Tensor, owner: Tensor, table: CellTable) -> tuple[Tensor, Tensor]:
    """Which cells a bilinear value and its central differences are made of, and how.

    Args:
        cells: (M, N, 2), one cell or more from the border.
        owner: (M,) which map of the batch each row of points looks at.
        table: of the maps.

    Returns:
        Cell numbers (M, N, 12), and weights (M, N, 3, 12) of the value, its slope along x and its
        slope along y, per cell. A slope is half the difference of the values one cell before and
        one cell after.
    """
    corner = cells.detach().floor()
    a, b = (cells - corner).unbind(-1)
    zero = torch.zeros_like(a)
    value_x, value_y = (torch.stack([zero, 1 - t, t, zero], -1) for t in (a, b))
    slope_x, slope_y = (0.5 * torch.stack([t - 1, -t, 1 - t, t], -1) for t in (a, b))
    rows = torch.stack([value_y, value_y, slope_y], -2)
    columns = torch.stack([value_x, slope_x, value_x], -2)
    weights = (rows[..., :, None] * columns[..., None, :]).flatten(-2)[..., _USED]

    used = torch.tensor([_SQUARE[k] for k in _USED], device=cells.device)
    at = corner.long()[..., None, :] + used
    x = at[..., 0].clamp(0, table.width - 1)
    y = at[..., 1].clamp(0, table.height - 1)
    first = owner[:, None, None] * (table.width * table.height)
    return first + y * table.width + x, weights


def sample(maps: Tensor, xy: Tensor, stride: Stride, border: float = 0) -> tuple[Tensor, Tensor]:
    """Bilinear values of maps at pixels.

    Args:
        maps: (B, C, h, w).
        xy: (B, N, 2) pixels, finite or not.
        stride: pixels per cell.
        border: cells; points nearer to the border do not count as inside.

    Returns:
        Values (B, N, C), those of some cell where a point is not inside; (B, N) whether it is.
    """
    table = CellTable.of(maps)
    cells = to_cells(xy, stride)
    seen = inside(cells, table.width, table.height, max(border, 0))
    owner = torch.arange(len(maps), device=maps.device)
    index, weights = stencil(torch.where(seen[..., None], cells, 0), owner, table)
    values = weights[..., :1, :].to(maps.dtype if maps.dtype == torch.float64 else torch.float32)
    return (values @ table.gather(index))[..., 0, :], seen
