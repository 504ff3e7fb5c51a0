"""Bilinear interpolation of feature maps and of their slopes.

The cell in row i and column j of a map of stride s is centred on pixel ((j + 0.5) s, (i + 0.5) s)
in COLMAP's pixel coordinates. A position in cells is (x, y) with the centre of that cell at (j, i).
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


def inside(positions: Tensor, width: int, height: int, border: float) -> Tensor:
    """Return whether positions in cells (..., 2) are in a map, at least ``border`` from its edge.

    The edge runs through the centres of the outermost cells.
    """
    last = torch.tensor([width - 1 - border, height - 1 - border], device=positions.device)
    return ((positions >= border) & (positions <= last)).all(-1)


@dataclass(frozen=True)
class CellTable:
    """Maps of a batch as one table of cells, which any number of points share.

    Attributes:
        values: (B h w, C) of any floating type, one row per cell; a view of the maps if they are
            channels-last in memory.
        width: cells in a row of a map.
        height: rows of a map.
    """

    values: Tensor
    width: int
    height: int

    @staticmethod
    def of(maps: Tensor) -> CellTable:
        """Build the table of maps (B, C, h, w)."""
        _, channels, height, width = maps.shape
        return CellTable(maps.permute(0, 2, 3, 1).reshape(-1, channels), width, height)

    def first(self, maps: Tensor) -> Tensor:
        """Return the index of the first cell of each map, given indices of maps in the batch."""
        return maps * (self.width * self.height)

    def gather(self, index: Tensor) -> Tensor:
        """Return values (..., k, C) of cells by index (..., k), at least in single precision."""
        values = self.values.index_select(0, index.flatten())
        values = values.view(*index.shape, self.values.shape[-1])
        return values if values.dtype == torch.float64 else values.float()

    def value_and_slopes(self, index: Tensor, weights: Tensor) -> Tensor:
        """Return value and slopes (M, N, 3, C) by indices and weights (M, N, 20) of ``stencil``.

        ``embedding_bag`` gathers and sums in one pass. It takes a tenth of the time of a product
        with the gathered values, which exceed the processor's cache.
        """
        shape, index = index.shape[:-1], index.flatten()
        parts = torch.tensor(_PARTS, device=index.device)
        bags = torch.arange(0, len(index), STENCIL, device=index.device)[:, None] + parts
        sums = embedding_bag(
            index,
            self.values,
            bags.flatten(),
            mode="sum",
            per_sample_weights=weights.to(self.values).flatten(),
        )
        return sums.view(*shape, 3, self.values.shape[-1])

    def value(self, index: Tensor, weights: Tensor) -> Tensor:
        """Return the value (M, N, C) by indices and weights (M, N, 20) of ``stencil``."""
        value = embedding_bag(
            index[..., :VALUE_CELLS].flatten(0, -2),
            self.values,
            mode="sum",
            per_sample_weights=weights[..., :VALUE_CELLS].flatten(0, -2).to(self.values),
        )
        return value.view(*index.shape[:-1], self.values.shape[-1])


def _stencil_basis() -> tuple[list[tuple[int, int]], Tensor]:
    """Return the offsets (x, y) of the stencil's 20 cells, and the matrix (4, 20) that maps 1, a, b
    and ab to their weights at the position (a, b) between cells."""
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

    # Weights are bilinear in (a, b), so that their values at the corners determine them.
    w00, w10, w01, w11 = (weights(a, b).double() for b in (0.0, 1.0) for a in (0.0, 1.0))
    return [(x, y) for _, x, y in placed], torch.stack(
        [w00, w10 - w00, w01 - w00, w11 - w10 - w01 + w00]
    )


# Offsets of the cells of a bilinear value (4), of its slope along x (8) and along y (8).
_OFFSETS, _BASIS = _stencil_basis()
STENCIL: Final = len(_OFFSETS)
"""Number of cells of the stencil."""
VALUE_CELLS: Final = 4
"""Number of cells of the stencil that give the value; they come first."""
# Where the cells of the value, the slope along x and the slope along y begin.
_PARTS: Final = (0, VALUE_CELLS, 12)


def stencil(positions: Tensor, table: CellTable, first: Tensor) -> tuple[Tensor, Tensor]:
    """Return indices and weights of the cells of a bilinear value and its central differences.

    Args:
        positions: (M, N, 2) positions in cells, at least one cell from the border.
        table: table of the maps.
        first: (M,) index of the first cell of each row's map.

    Returns:
        Indices of cells (M, N, 20) and their weights (M, N, 20): four cells of the value, eight of
        its slope along x and eight of its slope along y. A slope is half the difference of the
        values one cell before and one cell after.
    """
    last = torch.tensor([table.width - 3, table.height - 3], device=positions.device)
    corner = positions.detach().floor().clamp_min(1).minimum(last)
    between = positions - corner
    powers = torch.cat([torch.ones_like(between[..., :1]), between, between.prod(-1, True)], -1)
    weights = powers @ _BASIS.to(positions)
    x, y = corner.long().unbind(-1)
    offsets = torch.tensor([v * table.width + u for u, v in _OFFSETS], device=positions.device)
    index = (first[:, None] + y * table.width + x)[..., None] + offsets
    return index.clamp_(0, len(table.values) - 1), weights


def sample(maps: Tensor, xy: Tensor, stride: Stride, border: float = 0) -> tuple[Tensor, Tensor]:
    """Sample maps bilinearly at pixels.

    Args:
        maps: (B, C, h, w).
        xy: (B, N, 2) pixels, finite or not.
        stride: pixels per cell.
        border: cells; points nearer to the edge are outside.

    Returns:
        Values (B, N, C), arbitrary for points outside, and whether points are inside (B, N).

    Examples:
        Cells are centred on half pixels, so pixel 1.0 lies between the first two cells:

        >>> maps = torch.tensor([[[[0.0, 1.0, 2.0]]]])
        >>> values, inside = sample(maps, torch.tensor([[[1.0, 0.5], [5.0, 0.5]]]), stride=1.0)
        >>> values[0, 0].tolist(), inside.tolist()
        ([0.5], [[True, False]])
    """
    table = CellTable.of(maps)
    positions = xy / per_axis(stride, xy) - 0.5
    seen = inside(positions, table.width, table.height, max(border, 0))
    positions = torch.where(seen[..., None], positions, 0)
    corner = positions.detach().floor()
    a, b = (positions - corner).unbind(-1)
    x, y = corner.long().unbind(-1)
    right, below = (x + 1).clamp_max(table.width - 1), (y + 1).clamp_max(table.height - 1)
    first = table.first(torch.arange(len(maps), device=maps.device))[:, None]
    index = torch.stack([v * table.width + u for v in (y, below) for u in (x, right)], -1)
    weights = torch.stack([v * u for v in (1 - b, b) for u in (1 - a, a)], -1)
    values = table.gather(first[..., None] + index)
    return (weights[..., None, :].to(values.dtype) @ values)[..., 0, :], seen
