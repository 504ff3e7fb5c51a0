"""Feature maps of a photograph that is rotated, resized and passed through a network."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from objconnect.learning.inference import resolve_precision
from objconnect.localization.align.sampling import sample
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.views import WarpedImage, level_image, warp_image
from objconnect.scene.runtime.tuning import retain_heap
from objconnect.scene.storage.lru_cache import MEGABYTE

# Peak memory of a pass of the networks, bytes per pixel, beside the output.
_PASS_BYTES: Final = 320
# The networks crop the sides of an image to multiples of this many pixels, the coarsest stride.
_COARSEST_STRIDE: Final = 16


class Levels(Protocol):
    """The levels of a network, coarse to fine."""

    @property
    def strides(self) -> tuple[int, ...]:
        """Pixels per cell of each level."""
        ...

    @property
    def dims(self) -> tuple[int, ...]:
        """Number of channels of each level."""
        ...


class Network(Protocol):
    """A network with features for alignment."""

    @property
    def config(self) -> Levels:
        """Its levels."""
        ...

    @property
    def damping(self) -> nn.ModuleList:
        """A ``Damping`` of every level, learned with the features."""
        ...

    def __call__(
        self, image: Tensor, *, levels: int | None = None, needed: NDArray[np.bool_] | None = None
    ) -> Iterable[tuple[Tensor, Tensor]]:
        """Return, per level from coarse to fine, features (B, C, h, w), not normalised, and
        confidences (B, 1, h, w) in 0..1.

        Args:
            image: (B, 3, H, W) RGB bytes.
            levels: number of levels from the coarsest; None for all.
            needed: (h, w) cells of the finest level that are needed; None for all.
        """
        ...


@dataclass(frozen=True)
class FeatureMap:
    """One level of one view, on the device of the network.

    Attributes:
        features: (1, C, h, w) float32, not normalised.
        confidence: (1, 1, h, w) float32 in 0..1; 0 where the view does not show the photograph.
        stride: pixels of the view per cell.
    """

    features: Tensor
    confidence: Tensor
    stride: int

    def halve(self) -> FeatureMap:
        """Return the map with cells of twice the side: confidence-weighted means of four cells."""
        weighted = torch.nn.functional.normalize(self.features, dim=1) * self.confidence
        return FeatureMap(
            torch.nn.functional.avg_pool2d(weighted, 2, ceil_mode=True),
            torch.nn.functional.avg_pool2d(self.confidence, 2, ceil_mode=True),
            2 * self.stride,
        )

    def sample(self, xy: Tensor) -> tuple[Tensor, Tensor]:
        """Sample unit features (N, C) and confidence (N,) at pixels of the view (N, 2).

        The result is on the device of the map. Pixels are clamped to half a cell from the edge.
        """
        height, width = self.features.shape[-2:]
        half, xy = self.stride / 2, xy.to(self.features.device)
        limit = xy.new_tensor([width, height]) * self.stride - half
        clamped = torch.minimum(xy.clamp(min=half), limit)
        features, _ = sample(self.features, clamped[None], self.stride)
        confidence, _ = sample(self.confidence, clamped[None], self.stride)
        return torch.nn.functional.normalize(features[0], dim=-1), confidence[0, :, 0]


class MapExtractor:
    """Runs a network on photographs of any size, on the device of the network.

    Args:
        network: trained network in evaluation mode.
        longest: larger photographs are resized to this longer side (px).
        precision: precision of the convolutions, ``objconnect.learning.inference.Precision``.
    """

    def __init__(self, network: Network, longest: int, precision: str) -> None:
        retain_heap()
        self.network = network
        self.longest = longest
        self._precision = precision
        self._bfloat16 = resolve_precision(precision) == "bfloat16"

    @property
    def device(self) -> torch.device:
        """Return the device of the network and of its maps."""
        return next(self.network.damping.parameters()).device

    def with_network(self, network: Network) -> MapExtractor:
        """Return an extractor with the same options for another network."""
        return MapExtractor(network, self.longest, self._precision)

    def __call__(
        self,
        rgb: NDArray[np.uint8],
        camera: Camera,
        angle: float = 0.0,
        scale: float = 1.0,
        levels: int | None = None,
        view_from_camera: NDArray[np.float64] | None = None,
    ) -> tuple[WarpedImage, list[FeatureMap]]:
        """Warp a photograph and compute its feature maps.

        Args:
            rgb: (H, W, 3); its shorter side has at least 16 pixels after resizing.
            camera: camera of the photograph.
            angle: rotation in the image plane, radians counter-clockwise.
            scale: scale factor.
            levels: number of levels to compute, from the coarsest; None for all.
            view_from_camera: (3, 3) rotation of the camera; None rotates by ``angle``.

        Returns:
            The warped photograph and its levels, coarse to fine.
        """
        view = self.warp(rgb, camera, angle, scale, view_from_camera)
        return view, self.features(view, levels)

    def warp(
        self,
        rgb: NDArray[np.uint8],
        camera: Camera,
        angle: float,
        scale: float,
        view_from_camera: NDArray[np.float64] | None = None,
    ) -> WarpedImage:
        """Warp a photograph as the call of the extractor does, with the same arguments."""
        scale = min(scale, self.largest_scale(camera, math.inf))
        if view_from_camera is None:
            return warp_image(rgb, camera, angle, scale)
        return level_image(rgb, camera, view_from_camera, scale)

    @torch.inference_mode()
    def features(self, view: WarpedImage, levels: int | None = None) -> list[FeatureMap]:
        """Compute the feature maps of a warped photograph, coarse to fine.

        Args:
            view: the warped photograph.
            levels: number of levels to compute, from the coarsest; None for all.
        """
        strides = self.network.config.strides
        sides = view.picture.shape[:2]
        size = tuple(side // _COARSEST_STRIDE * _COARSEST_STRIDE // strides[-1] for side in sides)
        needed = None if view.is_filled else _find_covered_cells(view, size, strides[-1])
        outputs, maps = self._run_network(view, levels, needed), []
        for stride in strides[:levels]:
            features, confidence = outputs.pop(0)  # frees the network's output once it is converted
            confidence = confidence.float()
            if needed is not None:
                is_finest = stride == strides[-1]
                shown = (
                    needed
                    if is_finest
                    else _find_covered_cells(view, confidence.shape[-2:], stride)
                )
                confidence = confidence * torch.from_numpy(shown).to(self.device)
            maps.append(FeatureMap(features.float(), confidence, stride))
        return maps

    def _run_network(
        self, view: WarpedImage, levels: int | None, needed: NDArray[np.bool_] | None
    ) -> list[tuple[Tensor, Tensor]]:
        """Run the network; see ``Network.__call__``."""
        # The RGB picture (h, w, 3) is channels-last in memory already, as convolutions want it.
        picture = np.require(view.picture, requirements=("C_CONTIGUOUS", "WRITEABLE"))
        image = torch.from_numpy(picture).to(self.device).permute(2, 0, 1)[None]
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self._bfloat16):
            return list(self.network(image, levels=levels, needed=needed))

    def largest_scale(self, camera: Camera, max_magnification: float = 1.0) -> float:
        """Return the largest scale of photographs of a camera: ``max_magnification``, or less if
        ``longest`` requires it."""
        return min(max_magnification, self.longest / max(camera.width, camera.height))

    def pass_megabytes(self, cameras: Iterable[Camera], max_magnification: float) -> int:
        """Return the approximate peak memory (MB) of a pass on a photograph of any of the cameras,
        rotated by any angle and enlarged by at most ``max_magnification``."""
        sides = (
            self.largest_scale(camera, max_magnification) * math.hypot(camera.width, camera.height)
            for camera in cameras
        )
        return round(max(sides, default=0.0) ** 2 * _PASS_BYTES / MEGABYTE)


def _find_covered_cells(view: WarpedImage, size: Sequence[int], stride: int) -> NDArray[np.bool_]:
    """Return which cells (h, w) of a level show the photograph."""
    height, width = size
    x, y = np.meshgrid((np.arange(width) + 0.5) * stride, (np.arange(height) + 0.5) * stride)
    return view.shows(np.stack([x, y], -1))
