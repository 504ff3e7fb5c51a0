"""A classifier of places: on a thing or on the ground, from what photographs measured there.

A small network learned it on towns whose things are known.

A thing of 4 pixels lies a pixel or two away from where the ground under it would be. No single
figure tells it from a mark on the ground; many together do.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from baselines.checkpoint import load_into, read_weights, shipped
from mapping.supplement.blobs import Blobs
from mapping.supplement.ground_plane import Ground
from mapping.supplement.photoconsistency import HEIGHTS, costs_beside_ground
from mapping.supplement.tracks import Tracks
from scene.errors import InputError
from scene.maps.sparse_map import MapImage

SHIPPED: Final = Path(__file__).with_name("supplement.safetensors")
"""The weights that come with the project."""

# What the trained classifier is made of and takes: other values need other weights.
_WIDTHS: Final = (64, 32)
_OF_TRACKS: Final = 15
_LOOK: Final = 9
FIGURES: Final = _OF_TRACKS + len(HEIGHTS) + _LOOK
"""How many figures a place has."""

# Beyond these a figure says no more.
_MOST_SHARE, _MOST_OFF, _MOST_COST = 1.5, 3.0, 3.0
_SURE_M: Final = 1e-3


def measured(
    images: Sequence[MapImage],
    blobs: Sequence[Blobs],
    ground: Ground,
    tracks: Tracks,
    place_costs: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Compute the figures of places that the classifier takes, (T, ``FIGURES``).

    They are the height above the ground (m), its standard deviation (log) and their ratio;
    reprojection error, photographs that show a blob there and that have the place in view; how the
    colours agree at heights, beside the ground's; the blobs' strength, size and difference from
    what is around, but not their colours themselves; from how many sides they are seen.

    Args:
        images: photographs.
        blobs: of each photograph.
        ground: under them.
        tracks: T places.
        place_costs: (T, H) of ``photoconsistency.costs``.
    """
    count = len(tracks.xyz)
    views = tracks.views.clip(1)
    first = np.cumsum([0] + [len(each.xy) for each in blobs])[:-1]
    blob = first[tracks.view] + tracks.row if len(tracks.view) else tracks.view

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Over the observations (O,) of each place, (T,)."""
        return np.asarray(np.bincount(tracks.track, values, count) / views)

    def deviation(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.sqrt((mean(values**2) - mean(values) ** 2).clip(0)))

    def seen(name: str) -> NDArray[np.float64]:
        every = np.concatenate([getattr(each, name) for each in blobs])
        return np.asarray(every[blob], np.float64)

    centres = np.array([image.centre for image in images])
    focal = np.array([min(image.camera.focal) for image in images])
    ray = tracks.xyz[tracks.track] - centres[tracks.view]
    distance = np.linalg.norm(ray, axis=1)
    slope = ray[:, :2] / np.minimum(ray[:, 2:], -1e-6)
    spread = np.stack([deviation(slope[:, axis]) for axis in range(2)])
    pixel = mean(distance / focal[tracks.view])
    crossing = np.sqrt(views * ((spread**2).sum(0) + 1e-9))
    sigma = tracks.error_px * pixel / crossing
    above = tracks.xyz[:, 2] - ground.at(tracks.xyz[:, :2])
    beside = costs_beside_ground(place_costs, above)
    strength, look = seen("strength"), seen("look")
    figures = [
        above,
        np.log(sigma + _SURE_M),
        above / (sigma + 0.05),
        tracks.error_px,
        views,
        tracks.visible,
        views / tracks.visible.clip(1),
        beside.share.clip(0, _MOST_SHARE),
        beside.off.clip(0, _MOST_OFF),
        mean(strength),
        deviation(strength) / mean(strength).clip(1),
        *spread,
        beside.on_ground,
        mean(seen("radius")),
        *beside.curve.clip(0, _MOST_COST).T,
        *(mean(look[:, k]) for k in range(_LOOK)),
    ]
    return np.asarray(np.stack(figures, 1), np.float32)


class PlaceClassifier(nn.Module):
    """Logits of places (T, F) being on a thing: a perceptron of two layers over figures of mean 0
    and deviation 1."""

    mean: Tensor
    deviation: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(FIGURES))
        self.register_buffer("deviation", torch.ones(FIGURES))
        first, second = _WIDTHS
        self.layers = nn.Sequential(
            nn.Linear(FIGURES, first),
            nn.GELU(),
            nn.Linear(first, second),
            nn.GELU(),
            nn.Linear(second, 1),
        )

    def forward(self, figures: Tensor) -> Tensor:
        logits: Tensor = self.layers((figures - self.mean) / self.deviation)[..., 0]
        return logits

    @torch.inference_mode()
    def likely(self, figures: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the probability of each place being on a thing, (T,)."""
        probabilities = torch.sigmoid(self(torch.from_numpy(figures)))
        return np.asarray(probabilities.numpy(), np.float64)


def read_classifier(path: Path | None = None) -> PlaceClassifier:
    """The classifier that comes with the project, or one of a file.

    Raises:
        InputError: no such file, or not a classifier's.
    """
    path = path or shipped(SHIPPED)
    weights = read_weights(path)
    if weights.config.get("figures") != FIGURES:
        raise InputError(f"{path} does not judge places by the {FIGURES} figures of this version")
    classifier = PlaceClassifier()
    load_into(classifier, weights.tensors, path)
    return classifier.eval()
