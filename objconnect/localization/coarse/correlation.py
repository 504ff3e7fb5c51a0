"""Sums over the cells of a query at shifted or projected positions of a mosaic.

Each function uses compiled loops where they apply, else torch. Results differ by rounding.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import grid_sample, normalize, pad

from objconnect.localization.coarse.mosaic import Mosaic
from objconnect.scene.runtime.device import supports_loops
from objconnect.scene.runtime.loops import compile_loop


def sum_shifted(
    planes: Tensor, known: Tensor, shifts: Tensor, weights: Tensor, every: int = 1
) -> tuple[Tensor, Tensor]:
    """Return the sums (T, H, W) of shifted planes, and of shifted known cells, for T hypotheses.

    At position (y, x) the sum of hypothesis t is that of ``weights[t, n] * planes[n, y + row, x +
    column]`` over n, where ``shifts[t, n]`` is column and row. Positions beyond the planes count
    as 0.

    Args:
        planes: (N, H, W) float32, one plane for each cell of the query.
        known: (H, W) float32.
        shifts: (T, N, 2) int32 columns and rows.
        weights: (T, N) float32.
        every: known cells are summed for every n-th plane only.
    """
    if supports_loops(planes.device):
        from objconnect.localization.coarse.kernels import SUM_SHIFTED
        from objconnect.localization.coarse.kernels import sum_shifted as loop

        arrays = [each.contiguous().numpy() for each in (planes, known, shifts, weights)]
        sums = planes.new_zeros(len(shifts), *known.shape)
        overlaps = torch.zeros_like(sums)
        compile_loop(loop, SUM_SHIFTED)(*arrays, every, sums.numpy(), overlaps.numpy())
        return sums, overlaps
    return _sum_shifted_by_torch(planes, known, shifts, weights, every)


def _sum_shifted_by_torch(
    planes: Tensor, known: Tensor, shifts: Tensor, weights: Tensor, every: int
) -> tuple[Tensor, Tensor]:
    """Return what ``sum_shifted`` returns, hypothesis by hypothesis."""
    rows, columns = known.shape
    limit = shifts.new_tensor([columns, rows])
    shifts = torch.minimum(torch.maximum(shifts, -limit), limit).long()  # all beyond is 0
    margin = (columns, columns, rows, rows)
    padded, padded_known = pad(planes, margin), pad(known, margin)
    width = 3 * columns
    y, x = torch.meshgrid(
        torch.arange(rows, device=known.device),
        torch.arange(columns, device=known.device),
        indexing="ij",
    )
    position = ((y + rows) * width + x + columns).flatten()
    sums, overlaps = [], []
    for shift, weight in zip(shifts, weights, strict=True):
        at = position + (shift[:, 1] * width + shift[:, 0])[:, None]
        sums.append(weight @ padded.flatten(1).gather(1, at))
        overlaps.append(weight[::every] @ padded_known.flatten()[at[::every]])
    shape = (len(shifts), rows, columns)
    return torch.stack(sums).view(shape), torch.stack(overlaps).view(shape)


class MosaicSampler:
    """Compares features with those of a mosaic between its cells.

    Args:
        mosaic: the mosaic.
    """

    def __init__(self, mosaic: Mosaic) -> None:
        self.mosaic = mosaic
        self._channels_last = mosaic.features.permute(1, 2, 0).contiguous()

    def compare(
        self, features: Tensor, positions: Tensor, weights: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the weighted sum of cosines (P,), and that of the shares of known ground (P,).

        Args:
            features: (N, K) unit features.
            positions: (P, N, 2) float32, columns and rows in cells; whole numbers are centres.
            weights: (P, N) float32.
        """
        if supports_loops(features.device):
            from objconnect.localization.coarse.kernels import COMPARE
            from objconnect.localization.coarse.kernels import compare as loop

            tensors = (self._channels_last, self.mosaic.known, features, positions, weights)
            arrays = [each.contiguous().numpy() for each in tensors]
            sums = features.new_zeros(len(positions))
            overlaps = torch.zeros_like(sums)
            compile_loop(loop, COMPARE)(*arrays, sums.numpy(), overlaps.numpy())
            return sums, overlaps
        return self._compare_by_torch(features, positions, weights)

    def _compare_by_torch(
        self, features: Tensor, positions: Tensor, weights: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return what ``compare`` returns."""
        known = self.mosaic.known
        rows, columns = known.shape
        layers = torch.cat([self.mosaic.features, known[None]])[None]
        grid = (2 * positions + 1) / positions.new_tensor([columns, rows]) - 1
        sampled = grid_sample(layers, grid[None], align_corners=False)[0]
        share = sampled[-1]
        # Between cells the mean of unit vectors is shorter.
        cosine = torch.einsum("kpn,nk->pn", normalize(sampled[:-1], dim=0), features)
        return (weights * share * cosine).sum(1), (weights * share).sum(1)
