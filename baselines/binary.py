"""Binary features of OpenCV: ORB (Rublee et al., ICCV 2011) and AKAZE (Alcantarilla et al., BMVC
2013), compared by Hamming distance.

The map was not built from these keypoints, so their 3D points are interpolated between the map's
observations.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from objconnect.localization.matching.features import Extractor
from objconnect.localization.matching.matcher import NearestNeighbours
from objconnect.localization.matching.structure import StructureConfig, StructureLocalizer
from objconnect.scene.maps.features import Features, unit_bits
from objconnect.scene.maps.matching import match

# Scale between levels of ORB's pyramid, OpenCV's default.
_ORB_STEP: Final = 1.2


class BinaryExtractor(Extractor):
    """An extractor of features with binary descriptors.

    Each call creates a detector, because OpenCV does not document detectors as thread-safe.
    """

    def __call__(self, rgb: NDArray[np.uint8]) -> Features:
        grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
        detector = self._create_detector()
        keypoints, descriptors = detector.detectAndCompute(grey, None)
        if not keypoints:
            empty = np.zeros(0, np.float32)
            no_bits = np.zeros((0, detector.descriptorSize()), np.uint8)
            return Features(empty.reshape(0, 2), empty, no_bits)
        scale = np.array([point.size for point in keypoints], np.float32)
        xy = self._pixels(keypoints, (grey.shape[1], grey.shape[0]))
        return Features(xy.astype(np.float32), scale, np.asarray(descriptors))

    @abstractmethod
    def _create_detector(self) -> cv2.Feature2D: ...

    def _pixels(
        self, keypoints: Sequence[cv2.KeyPoint], size: tuple[int, int]
    ) -> NDArray[np.float64]:
        """Convert keypoints in a picture of ``size`` to COLMAP's pixels (N, 2).

        OpenCV's origin is the centre of the first pixel.
        """
        return np.array([point.pt for point in keypoints]) + 0.5

    def unit(self, descriptors: NDArray[np.uint8]) -> Tensor:
        """Convert bits to signs; see ``unit_bits``."""
        return unit_bits(descriptors)

    def match(self, a: Tensor, b: Tensor, ratio: float) -> NDArray[np.int64]:
        """Match as ``Extractor.match`` does; ``ratio`` compares Hamming distances.

        ``match`` compares Euclidean distances of signs. A Hamming distance is proportional to the
        square of such a distance, so ``match`` gets the root of the ratio.
        """
        return match(a, b, ratio**0.5)


class Orb(BinaryExtractor):
    """Extracts ORB (oriented FAST and rotated BRIEF), at most ``max_features`` in an image."""

    name = "orb"

    def __init__(self, max_features: int) -> None:
        self.options = f"OpenCV {cv2.__version__}, {max_features} features"
        self._max_features = max_features

    def _create_detector(self) -> cv2.Feature2D:
        return cv2.ORB.create(self._max_features, _ORB_STEP)

    def _pixels(
        self, keypoints: Sequence[cv2.KeyPoint], size: tuple[int, int]
    ) -> NDArray[np.float64]:
        """Convert keypoints to COLMAP's pixels, without OpenCV's error of up to two pixels.

        OpenCV multiplies a level's pixels by the nominal scale, though the level's size is rounded.
        """
        step = _ORB_STEP ** np.array([point.octave for point in keypoints])[:, None]
        in_level = np.array([point.pt for point in keypoints]) / step + 0.5
        return np.asarray(in_level * size / np.round(size / step))


class Akaze(BinaryExtractor):
    """Extracts accelerated KAZE with its M-LDB descriptor, at most ``max_features`` in an image."""

    name = "akaze"

    def __init__(self, max_features: int, threshold: float = 0.001) -> None:
        self.options = f"OpenCV {cv2.__version__}, {max_features} features over {threshold}"
        self._max_features, self._threshold = max_features, threshold

    def _create_detector(self) -> cv2.Feature2D:
        return cv2.AKAZE.create(threshold=self._threshold, max_points=self._max_features)


class OrbConfig(StructureConfig):
    """Options of the orb localizer; see ``StructureConfig``."""


class AkazeConfig(StructureConfig):
    """Options of the akaze localizer; see ``StructureConfig``."""


class BinaryLocalizer(StructureLocalizer):
    """Localizes images by matches of binary features, and PnP."""

    def __init__(self, config: StructureConfig, extractor: BinaryExtractor) -> None:
        matcher = NearestNeighbours(extractor, config.ratio)
        super().__init__(config, extractor, matcher, interpolate=True)


class OrbLocalizer(BinaryLocalizer):
    """The localizer ``orb``: ORB matches with reference images, and PnP."""

    def __init__(self, config: OrbConfig) -> None:
        super().__init__(config, Orb(config.max_features))


class AkazeLocalizer(BinaryLocalizer):
    """The localizer ``akaze``: AKAZE matches with reference images, and PnP."""

    def __init__(self, config: AkazeConfig) -> None:
        super().__init__(config, Akaze(config.max_features))
