"""Class-agnostic object detector: the centre, size, cells and vector of each object.

Centres are peaks of a heat map, after Zhou et al., "Objects as Points" (2019). Cells belong to the
centre that they point to, after Cheng et al., "Panoptic-DeepLab" (CVPR 2020). The input is the
features of a network's levels, which are robust to a change of season.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from objconnect.network.config import DetectorConfig
from objconnect.network.segmentation import NOTHING

Level = tuple[Tensor, Tensor]
"""Features (B, C, h, w) and confidences (B, 1, h, w) of one level."""

# Initial logit of the heat map: a probability of about 0.01, because few cells hold a centre.
_INITIAL_LOGIT: Final = -4.6


class DetectorMaps(tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]):
    """Output maps of the detector for B images; see the properties."""

    @property
    def centre(self) -> Tensor:
        """Logit (B, h, w) that the centre of an object lies in the cell."""
        return self[0]

    @property
    def inside(self) -> Tensor:
        """Logit (B, h, w) that the cell belongs to an object."""
        return self[1]

    @property
    def offset(self) -> Tensor:
        """Cells (B, 2, h, w) x y from the middle of the cell to the centre of its object."""
        return self[2]

    @property
    def log_side(self) -> Tensor:
        """Logarithm (B, h, w) of the side of the cell's object, pixels."""
        return self[3]

    @property
    def rise(self) -> Tensor:
        """Value log(1 + h / s) per cell (B, h, w): h is the height of the object's centre above
        ground, s the object's side, both in pixels."""
        return self[4]

    @property
    def vector(self) -> Tensor:
        """Unit-length embeddings (B, V, h, w) for matching objects."""
        return self[5]


@dataclass(frozen=True)
class Detections:
    """The N objects of an image, the highest score first.

    Attributes:
        xy: (N, 2) centres, pixels.
        score: (N,) probability that there is an object.
        side: (N,) side of a square of the object's size, pixels.
        rise: (N,) height of the centre above the ground, converted to pixels at the object's depth.
        vectors: (N, V) unit-length embeddings for matching objects.
    """

    xy: Tensor
    score: Tensor
    side: Tensor
    rise: Tensor
    vectors: Tensor

    def __len__(self) -> int:
        return len(self.xy)

    def cpu(self) -> Detections:
        """Return the objects on the CPU."""
        parts = (self.xy, self.score, self.side, self.rise, self.vectors)
        return Detections(*(each.cpu() for each in parts))


class ObjectDetector(nn.Module):
    """A few convolutions over the features of all levels, resized to one stride.

    The names of the layers are the keys in files of weights, so they must not change.
    """

    def __init__(self, config: DetectorConfig, strides: Sequence[int], dims: Sequence[int]) -> None:
        super().__init__()
        self.config, self._strides = config, tuple(strides)
        size = config.size
        self.join = nn.Conv2d(sum(dims) + len(dims), size, 1)
        self.body = nn.Sequential(
            *(
                layer
                for dilation in (1, 2, 1)
                for layer in (
                    nn.ReLU(inplace=True),
                    nn.Conv2d(size, size, 3, padding=dilation, dilation=dilation),
                )
            ),
            nn.ReLU(inplace=True),
        )
        # Channels: centre, inside, offset (2), log_side, rise of DetectorMaps.
        self.places = nn.Conv2d(size, 6, 1)
        self.vectors = nn.Sequential(
            nn.Conv2d(size, size, 3, padding=1),
            nn.ReLU(inplace=True),
            nn.Conv2d(size, config.vector, 1),
        )
        with torch.no_grad():
            assert self.places.bias is not None
            self.places.bias.zero_()
            self.places.bias[0] = _INITIAL_LOGIT

    def forward(self, levels: Sequence[Level]) -> DetectorMaps:
        """Return the maps for the features and confidences of all levels.

        Features need not be normalized.
        """
        return self.detect(self.join_levels(levels))

    def join_levels(self, levels: Sequence[Level]) -> Tensor:
        """Return features and confidences of all levels, resized to the detector's stride.

        Features of C channels are normalized to length sqrt(C).
        """
        stride = self.config.stride
        shape = levels[self._strides.index(stride)][0].shape[-2:]
        parts = []
        for (features, confidence), level_stride in zip(levels, self._strides, strict=True):
            unit = functional.normalize(features, dim=1) * features.shape[1] ** 0.5
            both = torch.cat([unit, confidence], 1)
            if level_stride < stride:
                both = functional.avg_pool2d(both, stride // level_stride)[
                    ..., : shape[0], : shape[1]
                ]
            elif level_stride > stride:
                both = functional.interpolate(
                    both, scale_factor=level_stride / stride, mode="bilinear"
                )
                missing = [shape[1] - both.shape[3], shape[0] - both.shape[2]]
                both = functional.pad(both, (0, missing[0], 0, missing[1]), "replicate")
            parts.append(both)
        return torch.cat(parts, 1)

    def detect(self, joined: Tensor) -> DetectorMaps:
        """Return the maps for the result of ``join_levels``."""
        body = self.body(self.join(joined))
        maps = self.places(body)
        vector = functional.normalize(self.vectors(body), dim=1)
        return DetectorMaps((maps[:, 0], maps[:, 1], maps[:, 2:4], maps[:, 4], maps[:, 5], vector))


def extract_detections(maps: DetectorMaps, stride: int, count: int, min_score: float) -> Detections:
    """Return the objects of the first image of a batch: peaks of the heat map.

    Args:
        maps: maps of the detector.
        stride: pixels per cell.
        count: maximum number of objects.
        min_score: least probability of an object.
    """
    heat = torch.sigmoid(maps.centre[:1].float())
    peak = (heat == functional.max_pool2d(heat, 3, 1, 1)) & (heat >= min_score)
    rows, columns = torch.nonzero(peak[0], as_tuple=True)
    score, order = heat[0, rows, columns].sort(descending=True, stable=True)
    score, rows, columns = score[:count], rows[order[:count]], columns[order[:count]]
    middle = torch.stack([columns, rows], -1) + 0.5
    offset = maps.offset[0, :, rows, columns].T.clamp(-1.5, 1.5)
    side = maps.log_side[0, rows, columns].exp()
    return Detections(
        (middle + offset) * stride,
        score,
        side,
        maps.rise[0, rows, columns].clamp(min=0).expm1() * side,
        maps.vector[0, :, rows, columns].T,
    )


def label_map(maps: DetectorMaps, found: Detections, stride: int, cell: int) -> Tensor:
    """Return the row of the object of each cell of the first image, (h, w) int64, or ``NOTHING``.

    A cell inside an object belongs to the centre nearest to the position to which its offset
    points. If that centre is farther away than half the side of its object (or 1.5 cells of the
    maps, if that is more), the cell has no object.

    Args:
        maps: maps of the detector.
        found: objects of the image.
        stride: pixels per cell of the detector's maps.
        cell: pixels per cell of the label map. If it is less than ``stride``, the maps are
            interpolated, because many objects are only a few cells of the maps wide.
    """
    finer = max(1, stride // cell)
    # Positions are interpolated instead of offsets, which are relative to their cells.
    target = functional.interpolate(
        maps.offset[:1].float() + cell_centres(maps.offset), scale_factor=finer, mode="bilinear"
    )
    inside = functional.interpolate(
        maps.inside[:1, None].float(), scale_factor=finer, mode="bilinear"
    )
    labels = torch.full(target.shape[-2:], NOTHING, device=target.device)
    rows, columns = torch.nonzero(inside[0, 0] > 0, as_tuple=True)
    if not len(found) or not len(rows):
        return labels
    xy = target[0, :, rows, columns].T * stride
    distance, nearest = torch.cdist(xy, found.xy.float()).min(1)
    near = distance <= (found.side[nearest] / 2).clamp_min(1.5 * stride)
    labels[rows[near], columns[near]] = nearest[near]
    return labels


def cell_centres(maps: Tensor) -> Tensor:
    """Return the centre (2, h, w), x y in cells, of each cell of maps (..., h, w)."""
    rows, columns = (torch.arange(n, device=maps.device) + 0.5 for n in maps.shape[-2:])
    return torch.stack(torch.meshgrid(columns, rows, indexing="xy"))
