"""A step of D2-Net's training: from pairs of images and where they correspond to a loss."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from baselines.d2net.loss import TripletLoss, triplet_loss
from baselines.d2net.network import STRIDE, D2Net, soft_scores


class Pairs(Protocol):
    """Pairs of images of one size, and pixels that show the same point.

    Attributes:
        image_a: (B, 3, H, W) float RGB in 0..1.
        image_b: the same of the other images.
        xy_a: (B, N, 2) COLMAP pixels.
        xy_b: (B, N, 2) where the other image shows them.
        valid: (B, N) bool, which of them to use.
    """

    @property
    def image_a(self) -> Tensor: ...
    @property
    def image_b(self) -> Tensor: ...
    @property
    def xy_a(self) -> Tensor: ...
    @property
    def xy_b(self) -> Tensor: ...
    @property
    def valid(self) -> Tensor: ...


@dataclass(frozen=True)
class D2NetTraining:
    """See the module.

    Attributes:
        least: correspondences a pair must have to be learned from.
    """

    least: int = 128

    def step(self, network: D2Net, batch: Pairs) -> tuple[Tensor, dict[str, float]]:
        """Mean loss over the pairs with enough correspondences, and figures to watch.

        Pixels go to the cell they lie in, so that those drawn at centres of cells of stride 8
        (``8 k + 4``) in one of the images teach the most exact positions.

        Returns:
            a scalar to differentiate, zero where no pair serves, and ``loss``, ``positive``,
            ``negative``, ``right`` (means over pairs, see ``TripletLoss``; NaN without pairs) and
            ``pairs`` used.
        """
        count = len(batch.image_a)
        features = network(torch.cat([batch.image_a, batch.image_b]))
        scores = soft_scores(features)
        cells_a, inside_a = _cells(batch.xy_a, features)
        cells_b, inside_b = _cells(batch.xy_b, features)
        valid = batch.valid & inside_a & inside_b
        found: list[TripletLoss] = []
        for i in range(count):
            chosen = valid[i]
            if int(chosen.sum()) >= self.least:
                found.append(
                    triplet_loss(
                        features[i],
                        scores[i],
                        features[count + i],
                        scores[count + i],
                        cells_a[i, chosen],
                        cells_b[i, chosen],
                    )
                )
        if not found:
            nothing = dict.fromkeys(TripletLoss._fields, float("nan"))
            return features.sum() * 0, {**nothing, "pairs": 0.0}
        means = TripletLoss(*(torch.stack(column).mean() for column in zip(*found, strict=True)))
        figures = {name: float(value.detach()) for name, value in means._asdict().items()}
        return means.loss, {**figures, "pairs": float(len(found))}


def _cells(xy: Tensor, features: Tensor) -> tuple[Tensor, Tensor]:
    """The cells (..., 2) pixels lie in, and whether the features have them (...)."""
    # An invalid pixel may be NaN, which is no cell.
    cells = torch.nan_to_num(xy, nan=-1.0).div(STRIDE).floor().long()
    size = torch.tensor([features.shape[3], features.shape[2]], device=xy.device)
    return cells, ((cells >= 0) & (cells < size)).all(-1)
