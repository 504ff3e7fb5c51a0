"""Binary features of OpenCV: ORB (Rublee et al., ICCV 2011) and AKAZE (Alcantarilla et al., BMVC
2013), compared by Hamming distance.

The map was not built from them, so that their keypoints are lifted between its observations.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from baselines.features import Extractor
from baselines.structure import StructureConfig, StructureLocalizer
from scene.maps.features import Features, unit_bits
from scene.maps.matching import match

# From one level of ORB's pyramid to the next: OpenCV's own default, which pixels are converted by.
_ORB_STEP: Final = 1.2


class Binary(Extractor):
    """Features whose descriptors are bits.

    Detectors are not said to be safe in several threads at once and cost nothing to make: each
    picture has its own.
    """

    def __call__(self, rgb: NDArray[np.uint8]) -> Features:
        grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
        keypoints, descriptors = self._detector().detectAndCompute(grey, None)
        if not keypoints:
            nothing = np.zeros(0, np.float32)
            return Features(nothing.reshape(0, 2), nothing, np.zeros((0, 1), np.uint8))
        scale = np.array([point.size for point in keypoints], np.float32)
        xy = self._pixels(keypoints, (grey.shape[1], grey.shape[0]))
        return Features(xy.astype(np.float32), scale, np.asarray(descriptors))

    @abstractmethod
    def _detector(self) -> cv2.Feature2D: ...

    def _pixels(
        self, keypoints: Sequence[cv2.KeyPoint], size: tuple[int, int]
    ) -> NDArray[np.float64]:
        """COLMAP's pixels (N, 2) of keypoints in a picture of ``size``: OpenCV counts from the
        centre of the first pixel."""
        return np.array([point.pt for point in keypoints]) + 0.5

    def unit(self, descriptors: NDArray[np.uint8]) -> Tensor:
        """Bits as signs; see ``unit_bits``."""
        return unit_bits(descriptors)

    def match(self, a: Tensor, b: Tensor, ratio: float) -> NDArray[np.int64]:
        """The ratio is of Hamming distances, which are squared distances of the signs."""
        return match(a, b, ratio**0.5)


class Orb(Binary):
    """Oriented FAST and rotated BRIEF, at most ``max_features`` an image."""

    name = "orb"

    def __init__(self, max_features: int) -> None:
        self.options = f"OpenCV {cv2.__version__}, {max_features} features"
        self._max_features = max_features

    def _detector(self) -> cv2.Feature2D:
        return cv2.ORB.create(self._max_features, _ORB_STEP)

    def _pixels(
        self, keypoints: Sequence[cv2.KeyPoint], size: tuple[int, int]
    ) -> NDArray[np.float64]:
        """OpenCV multiplies a level's pixel by the nominal step to the level. The level was resized
        edge to edge and its size rounded, so that this is up to two pixels off."""
        step = _ORB_STEP ** np.array([point.octave for point in keypoints])[:, None]
        in_level = np.array([point.pt for point in keypoints]) / step + 0.5
        return np.asarray(in_level * size / np.round(size / step))


class Akaze(Binary):
    """Accelerated KAZE with its M-LDB descriptor, at most ``max_features`` an image."""

    name = "akaze"

    def __init__(self, max_features: int, threshold: float) -> None:
        self.options = f"OpenCV {cv2.__version__}, {max_features} features over {threshold}"
        self._max_features, self._threshold = max_features, threshold

    def _detector(self) -> cv2.Feature2D:
        return cv2.AKAZE.create(threshold=self._threshold, max_points=self._max_features)


class OrbConfig(StructureConfig):
    """Options of the orb localizer; see ``StructureConfig``."""


class AkazeConfig(StructureConfig):
    """Options of the akaze localizer; see ``StructureConfig``.

    Attributes:
        threshold: least response of the detector.
    """

    threshold: float = Field(0.001, gt=0)


class OrbLocalizer(StructureLocalizer):
    """ORB against the nearest photographs of the map."""

    def __init__(self, config: OrbConfig) -> None:
        super().__init__(config, Orb(config.max_features), interpolate=True)


class AkazeLocalizer(StructureLocalizer):
    """AKAZE against the nearest photographs of the map."""

    def __init__(self, config: AkazeConfig) -> None:
        super().__init__(config, Akaze(config.max_features, config.threshold), interpolate=True)
