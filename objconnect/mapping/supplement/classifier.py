"""Classify 3D points as lying on an object or on the ground.

The classifier is a small network, trained on rendered towns with known objects. Its inputs are
features measured in the photographs. An object of 4 pixels has a parallax of only one or two pixels
against the ground, so no single feature distinguishes it from a mark on the ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from objconnect.learning.checkpoint import load_into, read_weights, shipped_path
from objconnect.mapping.supplement.blobs import Blobs
from objconnect.mapping.supplement.ground_plane import Ground
from objconnect.mapping.supplement.photoconsistency import HEIGHTS, compare_with_ground
from objconnect.mapping.supplement.tracks import Tracks
from objconnect.scene.errors import InputError
from objconnect.scene.maps.sparse_map import MapImage

SHIPPED: Final = Path(__file__).with_name("supplement.safetensors")
"""The weights that come with the project."""

# Architecture and inputs of the trained classifier. Other values need other weights.
_WIDTHS: Final = (64, 32)
_TRACK_FEATURES: Final = 15
_APPEARANCE_FEATURES: Final = 9
NUM_FEATURES: Final = _TRACK_FEATURES + len(HEIGHTS) + _APPEARANCE_FEATURES
"""Number of features of a point."""

# Upper bounds of features: the minimum cost and the costs at all heights, as ratios to the cost at
# the ground, and the distance (m) between the height of minimum cost and the point.
_MAX_LEAST_COST, _MAX_COST, _MAX_DISTANCE_M = 1.5, 3.0, 3.0
# Added to standard deviations (m), so that their logarithm and the ratio to them stay finite.
_LOG_SIGMA_M: Final = 1e-3
_RATIO_SIGMA_M: Final = 0.05


def compute_features(
    images: Sequence[MapImage],
    blobs: Sequence[Blobs],
    ground: Ground,
    tracks: Tracks,
    costs: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Compute the classifier's inputs for the points of tracks, (T, ``NUM_FEATURES``).

    They are the height above the ground (m), its standard deviation (log) and their ratio; the
    reprojection error; the numbers of photographs with a blob at the point and with the point in
    view; the photoconsistency costs at several heights relative to the cost at the ground; the
    strength, size and contrast of the blobs, but not their colours; and the spread of viewing
    directions.

    Args:
        images: photographs of the map.
        blobs: blobs of each photograph.
        ground: the ground below the points.
        tracks: T tracks.
        costs: result (T, H) of ``photoconsistency.compute_costs``.
    """
    count = len(tracks.xyz)
    views = tracks.views.clip(1)
    first = np.cumsum([0] + [len(each.xy) for each in blobs])[:-1]
    blob = first[tracks.view] + tracks.row if len(tracks.view) else tracks.view

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the mean over the observations (O,) of each track, (T,)."""
        return np.asarray(np.bincount(tracks.track, values, count) / views)

    def deviation(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.sqrt((mean(values**2) - mean(values) ** 2).clip(0)))

    def look_up(name: str) -> NDArray[np.float64]:
        every = np.concatenate([getattr(each, name) for each in blobs])
        return np.asarray(every[blob], np.float64)

    centres = np.array([image.centre for image in images])
    focal = np.array([min(image.camera.focal) for image in images])
    ray = tracks.xyz[tracks.track] - centres[tracks.view]
    distance = np.linalg.norm(ray, axis=1)
    slope = ray[:, :2] / np.minimum(ray[:, 2:], -1e-6)
    spread = np.stack([deviation(slope[:, axis]) for axis in range(2)])
    pixel_m = mean(distance / focal[tracks.view])
    # Standard deviation of a height: the error on the ground over the spread of the rays' slopes.
    slope_norm = np.sqrt(views * ((spread**2).sum(0) + 1e-9))
    sigma = tracks.error_px * pixel_m / slope_norm
    height = tracks.xyz[:, 2] - ground.height_at(tracks.xyz[:, :2])
    relative = compare_with_ground(costs, height)
    strength, appearance = look_up("strength"), look_up("appearance")
    features = [
        height,
        np.log(sigma + _LOG_SIGMA_M),
        height / (sigma + _RATIO_SIGMA_M),
        tracks.error_px,
        views,
        tracks.visible,
        views / tracks.visible.clip(1),
        relative.least_ratio.clip(0, _MAX_LEAST_COST),
        relative.distance_m.clip(0, _MAX_DISTANCE_M),
        mean(strength),
        deviation(strength) / mean(strength).clip(1),
        *spread,
        relative.ground_cost,
        mean(look_up("radius_index")),
        *relative.ratios.clip(0, _MAX_COST).T,
        *(mean(appearance[:, k]) for k in range(_APPEARANCE_FEATURES)),
    ]
    return np.asarray(np.stack(features, 1), np.float32)


class PointClassifier(nn.Module):
    """A multilayer perceptron that maps features (T, F) to logits (T,) of being on an object.

    Features are normalised to mean 0 and deviation 1.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(NUM_FEATURES))
        self.register_buffer("deviation", torch.ones(NUM_FEATURES))
        first, second = _WIDTHS
        self.layers = nn.Sequential(
            nn.Linear(NUM_FEATURES, first),
            nn.GELU(),
            nn.Linear(first, second),
            nn.GELU(),
            nn.Linear(second, 1),
        )

    def forward(self, features: Tensor) -> Tensor:
        logits: Tensor = self.layers((features - self.mean) / self.deviation)[..., 0]
        return logits

    @torch.inference_mode()
    def predict(self, features: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the probability of each point being on an object, (T,)."""
        probabilities = torch.sigmoid(self(torch.from_numpy(features)))
        return np.asarray(probabilities.numpy(), np.float64)


def read_classifier(path: Path | None = None) -> PointClassifier:
    """Read the shipped classifier, or one from a file.

    Raises:
        InputError: the file does not exist, or holds no classifier.
    """
    path = path or shipped_path(SHIPPED)
    weights = read_weights(path)
    if weights.config.get("figures") != NUM_FEATURES:
        raise InputError(
            f"{path} is not a classifier of this version, with {NUM_FEATURES} features: "
            "train it again"
        )
    classifier = PointClassifier()
    load_into(classifier, weights.tensors, path)
    return classifier.eval()
