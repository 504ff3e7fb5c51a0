"""The localizer ``d2net``: D2-Net matches with reference images, and PnP.

The map was not built from these keypoints, so ``matching.lifting`` interpolates their 3D points
between the map's observations.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, Self

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, model_validator

from baselines.d2net.detection import EDGE_RATIO, detect
from baselines.d2net.network import D2Net, DenseD2Net, read_network
from objconnect.learning.checkpoint import shipped_path
from objconnect.learning.inference import Precision
from objconnect.localization.featuremetric.options import FeaturemetricConfig, NetworkOptions
from objconnect.localization.matching.features import Extractor
from objconnect.localization.matching.matcher import NearestNeighbours
from objconnect.localization.matching.structure import StructureConfig, StructureLocalizer
from objconnect.scene.config import with_default
from objconnect.scene.maps.features import Features
from objconnect.scene.runtime.device import torch_device
from objconnect.scene.runtime.tuning import retain_heap

SHIPPED: Final = Path(__file__).with_name("d2net.safetensors")
"""The shipped weights."""

# Minimum standard deviation of the grey levels in a window around a keypoint, and side (px) of the
# window. Without texture, keypoints are artefacts of the image border.
_MIN_CONTRAST: Final = 1.0
_CONTRAST_WINDOW_PX: Final = 33


class D2NetConfig(StructureConfig, NetworkOptions):
    """Options of the d2net localizer."""

    weights: Path | None = Field(
        None,
        description="File of weights (safetensors, or a checkpoint of the authors), or published "
        "weights: a folder or hf://OWNER/NAME@COMMIT; None for the shipped ones.",
    )
    precision: Precision = with_default(FeaturemetricConfig, "precision", "auto")
    scales: tuple[float, ...] = Field(
        (2.0,),
        min_length=1,
        description="Scales of the pyramid's levels, ascending. A keypoint's position is accurate "
        "to about one cell, which is four pixels wide in its level: at scale 2, poses are twice as "
        "accurate as at scale 1.",
    )
    max_edge: int = Field(
        2048,
        ge=64,
        description="Largest longer side of an image and of a level, px; if the largest level "
        "exceeds it, all levels shrink by the same factor.",
    )
    ratio: float = Field(
        0.9,
        gt=0,
        le=1,
        description="Ratio of nearest to second nearest descriptor distance. The authors use no "
        "ratio test. It helps where roofs repeat.",
    )
    max_error_px: float = Field(8.0, gt=0, description="Inlier threshold of RANSAC, px.")
    max_features: int = Field(6000, ge=100, description="Maximum number of features of an image.")

    @model_validator(mode="after")
    def _check_scales(self) -> Self:
        if min(self.scales) <= 0 or list(self.scales) != sorted(set(self.scales)):
            raise ValueError("scales must be positive and ascending")
        return self


class D2NetExtractor(Extractor):
    """Extracts the strongest ``max_features`` keypoints of an image."""

    name = "d2net"
    rotation_invariant = False

    def __init__(self, network: D2Net, weights_sha256: str, config: D2NetConfig) -> None:
        self._device = torch_device(config.device)
        # Allocating the feature maps of each picture again takes a fifth of the time.
        retain_heap()
        self._network = DenseD2Net(network, config.precision).to(self._device)
        self._config = config
        self._weights_sha256 = weights_sha256
        self.options = (
            f"{config.scales} {config.max_edge} {config.max_features} "
            f"{_MIN_CONTRAST} {_CONTRAST_WINDOW_PX} {EDGE_RATIO} {config.precision}"
        )

    @property
    def weights_sha256(self) -> str:
        """Return the digest of the network's weights."""
        return self._weights_sha256

    def __call__(self, rgb: NDArray[np.uint8]) -> Features:
        size = np.array(rgb.shape[1::-1])
        resized = np.round(size * min(1.0, self._config.max_edge / size.max())).astype(int)
        if (resized < size).any():
            rgb = np.asarray(cv2.resize(rgb, resized.tolist(), interpolation=cv2.INTER_AREA))
        image = torch.from_numpy(rgb.astype(np.float32, order="C") / 255).permute(2, 0, 1)
        with torch.inference_mode():
            scales = self._scales(resized.max())
            keypoints = detect(self._network, image.to(self._device), scales)
            strongest = keypoints.scores.argsort(descending=True, stable=True)
            xy, scale, descriptors = (
                values[strongest].cpu().numpy()
                for values in (keypoints.xy, keypoints.scale, keypoints.descriptors)
            )
        config = self._config
        kept = np.flatnonzero(_has_contrast(rgb, xy))[: config.max_features]
        xy, scale, descriptors = xy[kept], scale[kept], descriptors[kept]
        # Resizing keeps the image's edges, so coordinates counted from the edge are multiplied.
        magnification = (size / resized).astype(np.float32)
        # Half precision changes a descriptor by less than a thousandth and halves the cache.
        return Features(
            xy * magnification, scale * magnification.max(), descriptors.astype(np.float16)
        )

    def _scales(self, edge: int) -> list[float]:
        """Return the scales of the levels of an image with that longer side (px)."""
        scales = self._config.scales
        factor = min(1.0, self._config.max_edge / (edge * scales[-1]))
        return [scale * factor for scale in scales]


def _has_contrast(rgb: NDArray[np.uint8], xy: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return for each keypoint (N, 2) whether the picture has contrast around it, (N,).

    In images without texture, the padding of the convolutions causes peaks at the border. They are
    at the same positions in any two images, so matches between them would agree on a pose.
    """
    grey = cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2GRAY).astype(np.float32)
    window = (_CONTRAST_WINDOW_PX, _CONTRAST_WINDOW_PX)
    variance = cv2.blur(grey**2, window) - cv2.blur(grey, window) ** 2
    columns, rows = np.floor(xy).astype(int).T
    return np.asarray(variance[rows, columns] > _MIN_CONTRAST**2)


class D2NetLocalizer(StructureLocalizer):
    """The localizer ``d2net``."""

    def __init__(self, config: D2NetConfig) -> None:
        """Read the weights and prepare the extractor.

        Raises:
            InputError: there are no weights, or they belong to another network.
        """
        network, digest = read_network(config.weights or shipped_path(SHIPPED))
        extractor = D2NetExtractor(network, digest, config)
        matcher = NearestNeighbours(extractor, config.ratio)
        super().__init__(config, extractor, matcher, interpolate=True)
