"""Matchers, which pair the keypoints of a query with those of reference images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from objconnect.localization.matching.features import Extractor
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.views import roll_rotation


@dataclass(frozen=True)
class Keypoints:
    """Keypoints of one picture, for a matcher.

    Attributes:
        xy: (N, 2) float32 pixels from the picture's centre, x right and y down. For features that
            are not rotation-invariant the picture is rotated north up, and a query's picture
            is also resized to the map's resolution.
        size: width and height of the picture before the rotation, in the same pixels.
        descriptors: (N, D) as the extractor returns them.
    """

    xy: NDArray[np.float32]
    size: tuple[float, float]
    descriptors: NDArray[Any]


def transform_keypoints(
    xy: NDArray[np.float32],
    descriptors: NDArray[Any],
    camera: Camera,
    angle: float,
    scale: float = 1.0,
) -> Keypoints:
    """Rotate and scale the keypoints of a photograph for a matcher.

    Args:
        xy: (N, 2) COLMAP pixels of the photograph.
        descriptors: (N, D).
        camera: camera of the photograph.
        angle: angle by which the photograph was rotated counter-clockwise before the extraction,
            rad.
        scale: factor by which it was resized.
    """
    size = np.array([camera.width, camera.height])
    rotation = scale * roll_rotation(angle)[:2, :2]
    rotated = (xy - size / 2) @ rotation.T
    width, height = (scale * size).tolist()
    return Keypoints(rotated.astype(np.float32), (width, height), descriptors)


class Matcher(Protocol):
    """Pairs the keypoints of a query with those of its reference images."""

    def __call__(
        self, query: Keypoints, references: Sequence[Keypoints]
    ) -> Sequence[NDArray[np.int64]]:
        """Return for each reference image the rows (K, 2) of paired keypoints, query first."""
        ...


@dataclass(frozen=True)
class NearestNeighbours:
    """Pairs mutual nearest neighbours of descriptors that pass the ratio test.

    Attributes:
        extractor: extractor of the features, which also compares descriptors.
        ratio: largest ratio of nearest to second nearest descriptor distance.
    """

    extractor: Extractor
    ratio: float

    def __call__(
        self, query: Keypoints, references: Sequence[Keypoints]
    ) -> Sequence[NDArray[np.int64]]:
        """Return the pairs with each reference image; see ``Matcher``."""
        unit, match = self.extractor.unit, self.extractor.match
        query_descriptors = unit(query.descriptors)
        return [match(query_descriptors, unit(each.descriptors), self.ratio) for each in references]
