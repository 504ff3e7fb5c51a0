"""A localizer from a matcher of keypoints: SIFT with kornia's AdaLAM, `--method adalam`."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.localization.matching.matcher import Keypoints
from objconnect.localization.matching.sift import Sift
from objconnect.localization.matching.structure import MatchingConfig, StructureLocalizer
from objconnect.scene.config import load_config
from objconnect.scene.runtime.extras import import_extra

# Radius of a keypoint (px). All are alike, because pictures are north up and of one resolution.
RADIUS = 8.0


class AdalamConfig(MatchingConfig):
    """`--set references=8 --set max_features=4096` changes it."""


class UprightSift(Sift):
    """SIFT of pictures turned north up. `headings` are tried where the query's is unknown."""

    name = "adalam"
    rotation_invariant = False
    headings = 4


class Adalam:
    """Pairs keypoints whose neighbours agree on an affine map (Cavalli et al., ECCV 2020)."""

    def __init__(self, sift: Sift) -> None:
        self._kornia = import_extra("kornia.feature", "kornia", "--method adalam")
        self._sift = sift

    def __call__(
        self, query: Keypoints, references: Sequence[Keypoints]
    ) -> Sequence[NDArray[np.int64]]:
        return [self._pair(query, each) for each in references]

    def _pair(self, query: Keypoints, reference: Keypoints) -> NDArray[np.int64]:
        if min(len(query.xy), len(reference.xy)) < 2:
            return np.zeros((0, 2), np.int64)
        both = query, reference
        described = [self._sift.unit(each.descriptors) for each in both]
        frames = [self._frames(each.xy) for each in both]
        sizes = [tuple(int(side) for side in each.size[::-1]) for each in both]
        _, pairs = self._kornia.match_adalam(*described, *frames, hw1=sizes[0], hw2=sizes[1])
        return pairs.numpy()

    def _frames(self, xy: NDArray[np.float32]) -> torch.Tensor:
        """Return kornia's local affine frames (1, N, 2, 3) of keypoints."""
        radii = torch.full((1, len(xy), 1, 1), RADIUS)
        return self._kornia.laf_from_center_scale_ori(torch.from_numpy(xy)[None], radii)


def make(overrides: dict[str, Any]) -> StructureLocalizer:
    config = load_config(AdalamConfig, None, overrides)
    sift = UprightSift(config.max_features)
    return StructureLocalizer(config, sift, Adalam(sift), interpolate=True)
