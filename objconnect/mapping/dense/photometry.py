"""Photometric cost of a plane: bilaterally weighted NCC, as in Gipuma and COLMAP.

The cost is 1 - NCC, which is 0 where two windows are equal up to gain and offset. Within the small
window the warp is approximated as affine, which needs one division for all samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple, Protocol

import torch
from torch import Tensor
from torch.nn.functional import grid_sample, pad

from objconnect.mapping.dense.warp import StereoView, Warp, round_trip

WORST_COST = 2.0
"""Cost of an inverted picture, and of a view that does not see the plane."""

STEPS = (-4, -2, 0, 2, 4)
"""Offsets (px) of samples in a window of 9 x 9: every second row and column, as in Gipuma."""

NOISE_VARIANCE = 1e-5
"""Variance (of grey in 0..1) of noise. Windows with less variance have no texture."""

SIGMA_PX: Final = 4.0
"""Sigma (px) of the Gaussian weight of samples; the weight is 61 % at the middle of an edge."""

SIGMA_GREY: Final = 0.1
"""Difference in grey (0..1) at which the weight of a sample falls by a factor of e, because it is
likely on another surface."""

GEOMETRIC_WEIGHT: Final = 0.2
"""Additional cost per pixel of distance after a round trip through the map of another view."""

GEOMETRIC_LIMIT_PX: Final = 3.0
"""Upper bound (px) of the distance after a round trip, so that a single wrong map does not
decide."""


class Visibility(NamedTuple):
    """Visibility of the pixels of a picture in its sources.

    Attributes:
        seen: whether each of K sources shows a pixel, (K, H, W).
        num_counted: number (H, W) of sources whose costs are averaged: the better half, and at
            least two, so that occluded views are ignored.
    """

    seen: Tensor
    num_counted: Tensor

    @staticmethod
    def of(reference: StereoView, warps: Sequence[Warp], expected: Tensor) -> Visibility:
        """Compute the visibility from expected inverse depths (H, W) and warps to the sources."""
        grid = reference.camera.pixel_grid(torch.float32).to(reference.grey.device)
        x, y = grid.unbind(-1)
        seen = torch.stack([warp(x, y, expected).seen for warp in warps])
        count = seen.sum(0)
        return Visibility(seen, torch.maximum((count + 1) // 2, count.clamp_max(2)))


class Samples(NamedTuple):
    """S samples around each of m pixels that a source shows.

    Attributes:
        pixel_index: indices (m,) into the window's n pixels.
        x: column (m,) of the pixel's centre.
        y: row (m,) of the pixel's centre.
        weights: weights (S, m) of the samples, which sum to one.
        correlator: factors (S, m). The sum of their products with another window is the
            covariance of both windows over the standard deviation of this one.
    """

    pixel_index: Tensor
    x: Tensor
    y: Tensor
    weights: Tensor
    correlator: Tensor


class Window(NamedTuple):
    """Windows around n pixels of the reference view.

    Attributes:
        rows: row (n,) of the pixel.
        columns: column (n,) of the pixel.
        samples: samples for each source, around the pixels that it shows.
    """

    rows: Tensor
    columns: Tensor
    samples: tuple[Samples, ...]


class PlaneCosts(Protocol):
    """Interface of plane costs. Each implementation has its own type of window.

    Attributes:
        torch_threads: number of torch threads to use between calls.
    """

    torch_threads: int

    def window(self, rows: Tensor, columns: Tensor) -> Any:
        """Return the windows around pixels (n,) of the reference."""

    def cost(self, window: Any, planes: Tensor, bounds: Tensor | None = None) -> Tensor:
        """Return the cost of a plane at each pixel, the mean over the better half of its sources.

        Args:
            window: windows around n pixels.
            planes: (3, n).
            bounds: upper bounds (n,). Where the cost is not below its bound, any value not below
                the bound may be returned.
        """


class Photometry:
    """Costs of planes at pixels of one reference view against all its sources.

    Args:
        reference: the view whose planes are sought.
        sources: the source views.
        expected: inverse depths (H, W) that decide which sources show a pixel. A plane that leaves
            the picture of such a source is penalised; other sources are ignored.
        inverse_depths: inverse depth maps (H, W) of the sources, 0 where unknown. With them, a
            plane costs more where a source's map contradicts it.
    """

    def __init__(
        self,
        reference: StereoView,
        sources: Sequence[StereoView],
        expected: Tensor,
        inverse_depths: Sequence[Tensor] | None = None,
    ) -> None:
        self.torch_threads = torch.get_num_threads()
        self._grey = reference.grey
        self._sources = [source.grey[None, None] for source in sources]
        self._there = [Warp.between(reference, source) for source in sources]
        self._back = [Warp.between(source, reference) for source in sources]
        self._inverse_depths = inverse_depths
        self._seen, self._num_counted = Visibility.of(reference, self._there, expected)
        reach, device = STEPS[-1], reference.grey.device
        self._padded = pad(reference.grey[None, None], (reach,) * 4, mode="replicate")[0, 0]
        self._steps = torch.tensor(STEPS, dtype=torch.float32, device=device)
        dy, dx = torch.meshgrid(self._steps, self._steps, indexing="ij")
        offsets = (dy + reach) * self._padded.shape[1] + dx + reach
        self._offsets = offsets.reshape(-1, 1).long()
        self._near = torch.exp(-(dx**2 + dy**2) / (2 * SIGMA_PX**2)).reshape(-1, 1)

    def window(self, rows: Tensor, columns: Tensor) -> Window:
        """Return the windows around pixels (n,) of the reference."""
        around = self._offsets + rows * self._padded.shape[1] + columns
        # index_select is several times as fast as indexing.
        grey = self._padded.view(-1).index_select(0, around.view(-1)).view(around.shape)
        difference = (grey - self._grey[rows, columns]).abs()
        weights = self._near * torch.exp(difference / -SIGMA_GREY)
        weights = weights / weights.sum(0)
        central = grey - (weights * grey).sum(0)
        deviation = ((weights * central**2).sum(0) + NOISE_VARIANCE).sqrt()
        correlator = weights * central / deviation
        samples = []
        for seen in self._seen[:, rows, columns]:
            index = seen.nonzero()[:, 0]
            x, y = columns[index] + 0.5, rows[index] + 0.5
            factors = weights.index_select(1, index), correlator.index_select(1, index)
            samples.append(Samples(index, x, y, *factors))
        return Window(rows, columns, tuple(samples))

    def cost(self, window: Window, planes: Tensor, bounds: Tensor | None = None) -> Tensor:
        """Return the exact cost of a plane at each pixel; see ``PlaneCosts``."""
        costs = torch.full((len(self._sources), *planes.shape[1:]), torch.inf, device=planes.device)
        for k, samples in enumerate(window.samples):
            costs[k, samples.pixel_index] = self._cost_in(
                k, samples, planes.index_select(1, samples.pixel_index)
            )
        costs = _sort_costs(costs)
        num_counted = self._num_counted[window.rows, window.columns]
        counted = torch.arange(len(costs), device=num_counted.device)[:, None] < num_counted
        mean = torch.where(counted, costs, 0).sum(0) / num_counted.clamp_min(1)
        return torch.where(num_counted > 0, mean, WORST_COST)

    def _cost_in(self, k: int, samples: Samples, planes: Tensor) -> Tensor:
        """Return the cost (m,) of planes (3, m) in a source."""
        _, x, y, weights, correlator = samples
        w, gx, gy = planes
        warp = self._there[k]
        at = warp(x, y, w)
        ux, uy, vx, vy = warp.slopes(at, gx, gy)
        # In grid_sample's units, -1 and 1 are the edges of the picture. It is faster if all x are
        # contiguous and all y are, so the last axis of the grid is stored first.
        side = len(STEPS)
        grid = torch.empty(2, side, side, len(w), device=w.device)
        step = self._steps[:, None]
        for axis, (centre, along_x, along_y, size) in enumerate(
            ((at.u, ux, uy, warp.width), (at.v, vx, vy, warp.height))
        ):
            columns = step * (along_x * (2 / size)) + (centre * (2 / size) - 1)
            rows = step * (along_y * (2 / size))
            torch.add(rows[:, None], columns[None], out=grid[axis])
        # Torch parallelises over a batch and not within a picture, so each row of samples is an
        # item.
        grey = grid_sample(
            self._sources[k].expand(side, -1, -1, -1),
            grid.permute(1, 2, 3, 0),
            padding_mode="border",
            align_corners=False,
        ).view(side * side, -1)
        weighted = weights * grey
        mean = weighted.sum(0)
        variance = weighted.mul_(grey).sum(0) - mean * mean
        correlation = grey.mul_(correlator).sum(0) / (variance.clamp_min(0) + NOISE_VARIANCE).sqrt()
        cost = 1 - correlation.clamp(-1, 1)
        if self._inverse_depths is not None:
            pixels, _ = round_trip(warp, self._back[k], self._inverse_depths[k], x, y, w)
            limited = pixels.clamp_max(GEOMETRIC_LIMIT_PX)
            cost = cost + GEOMETRIC_WEIGHT * limited
        return torch.where(at.seen, cost, WORST_COST)


def _sort_costs(costs: Tensor) -> Tensor:
    """Sort costs (K, n) over K sources, faster than ``torch.sort`` for small K."""
    rows = list(costs)
    for last in range(len(rows) - 1, 0, -1):
        for k in range(last):
            a, b = rows[k], rows[k + 1]
            rows[k], rows[k + 1] = torch.minimum(a, b), torch.maximum(a, b)
    return torch.stack(rows)
