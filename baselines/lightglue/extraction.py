"""Keypoints of ALIKED and DISK."""

from __future__ import annotations

import math
from abc import abstractmethod
from functools import cached_property
from types import ModuleType
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from baselines.lightglue.config import AlikedLightGlueConfig, DiskLightGlueConfig
from baselines.lightglue.networks import (
    create_aliked,
    create_disk,
    create_lightglue,
    digest_weights,
    import_kornia,
)
from objconnect.localization.matching.features import Extractor
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.features import Features
from objconnect.scene.runtime.device import torch_device
from objconnect.scene.runtime.tuning import trim_heap
from objconnect.scene.storage.files import require_readable

# Maximum side (px) of a picture from which keypoints are extracted, which bounds memory.
_MAX_EDGE: Final = 2048
# Keypoints are detected in excess by this factor, because those at a picture's edges are dropped.
_EXCESS: Final = 1.5


class KorniaExtractor(Extractor):
    """Extracts the strongest keypoints of an image by a network of kornia.

    A call on an image returns up to 1.5 times ``max_features`` keypoints, because keypoints at the
    edges of a rotated photograph are dropped later; ``extract_warped`` returns up to
    ``max_features``.

    The networks are loaded when they are first used, so that a localizer can be made, and its
    options be listed, without kornia.

    Attributes:
        lightglue_name: kornia's name of LightGlue's weights for these keypoints.
    """

    rotation_invariant = False
    tilt_invariant = False
    headings = 4
    lightglue_name: str

    def __init__(self, config: AlikedLightGlueConfig | DiskLightGlueConfig) -> None:
        """Keep the configuration.

        Raises:
            InputError: a file of weights cannot be read, or torch does not find the device.
        """
        for path in (config.weights, config.matcher_weights):
            if path is not None:
                require_readable(path, "file of weights")
        self._config = config
        self.device = torch_device(config.device)
        self.options = (
            f"{config.extractor} {config.max_features} {config.magnification} {_MAX_EDGE} {_EXCESS}"
        )

    @cached_property
    def networks(self) -> tuple[nn.Module, nn.Module]:
        """The extractor and LightGlue.

        Raises:
            InputError: kornia is not installed, a file does not hold weights of its network, or
                weights cannot be downloaded.
        """
        kornia, config = import_kornia(self.name), self._config
        matcher = create_lightglue(
            kornia, self.lightglue_name, config.min_confidence, config.matcher_weights
        )
        return self._create(kornia).to(self.device), matcher.to(self.device)

    @property
    def weights_sha256(self) -> str:
        """Return the digest of the weights of both networks."""
        return self._digest

    @cached_property
    def _digest(self) -> str:
        return digest_weights(*self.networks)

    def __call__(self, rgb: NDArray[np.uint8]) -> Features:
        image = torch.from_numpy(rgb.astype(np.float32, order="C") / 255)
        with torch.inference_mode():
            found = self._detect(image.permute(2, 0, 1)[None].to(self.device))
            strongest = found[1].argsort(descending=True, stable=True)
            xy, descriptors = (values[strongest].cpu().numpy() for values in (found[0], found[2]))
        trim_heap()
        # Half precision changes a descriptor by less than a thousandth and halves the cache.
        return Features(
            xy.astype(np.float32) + np.float32(0.5),
            np.ones(len(xy), np.float32),
            descriptors.astype(np.float16),
        )

    def extract_warped(
        self, rgb: NDArray[np.uint8], camera: Camera, angle: float, scale: float = 1.0
    ) -> Features:
        """Extract from the photograph rotated, resized and magnified; see ``Extractor``."""
        height, width = rgb.shape[:2]
        sine, cosine = abs(math.sin(angle)), abs(math.cos(angle))
        longest = max(width * cosine + height * sine, height * cosine + width * sine)
        magnified = min(scale * self._config.magnification, _MAX_EDGE / longest)
        found = super().extract_warped(rgb, camera, angle, magnified)
        limit = self._config.max_features
        return Features(found.xy[:limit], found.scale[:limit], found.descriptors[:limit])

    @property
    def _limit(self) -> int:
        """The maximum number of keypoints to detect."""
        return int(_EXCESS * self._config.max_features)

    @abstractmethod
    def _create(self, kornia: ModuleType) -> nn.Module:
        """Return the network of the extractor."""

    @abstractmethod
    def _detect(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return keypoints of an image (1, 3, H, W) from 0 to 1.

        Returns:
            Pixel coordinates (N, 2), where the centre of the top-left pixel is (0, 0), scores (N,)
            and descriptors (N, D).
        """


class Aliked(KorniaExtractor):
    """Extracts ALIKED keypoints."""

    name = "aliked+lightglue"
    lightglue_name = "aliked"

    def _create(self, kornia: ModuleType) -> nn.Module:
        return create_aliked(kornia, self._config.extractor, self._limit, self._config.weights)

    def _detect(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        (found,) = self.networks[0](image)
        return found.keypoints, found.keypoint_scores, found.descriptors


class Disk(KorniaExtractor):
    """Extracts DISK keypoints."""

    name = "disk+lightglue"
    lightglue_name = "disk"

    def _create(self, kornia: ModuleType) -> nn.Module:
        return create_disk(kornia, self._config.extractor, self._config.weights)

    def _detect(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        (found,) = self.networks[0](image, n=self._limit, pad_if_not_divisible=True)
        return found.keypoints, found.detection_scores, found.descriptors
