"""A localizer from any matcher of the package vismatch: `--method vismatch --set matcher=roma`."""

import importlib
import logging
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from objconnect.localization.cache.map_cache import open_cache
from objconnect.localization.initial_poses import list_initial_poses
from objconnect.localization.matching.features import map_features
from objconnect.localization.matching.lifting import interpolate_points
from objconnect.localization.matching.pnp import PnpConfig, solve_pose
from objconnect.localization.matching.retrieval import LazyDescriptors, References
from objconnect.localization.matching.sift import Sift
from objconnect.scene.config import load_config
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import WarpedImage, north_angle, warp_image
from objconnect.scene.localizer import Estimate, Query, Status, Stopwatch, query_error
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.images import read_rgb

log = logging.getLogger(__name__)

# Number of SIFT features of a photograph, for retrieval without a prior.
RETRIEVAL_FEATURES = 2048
# In vismatch the centre of the top left pixel is (0, 0), in this project (0.5, 0.5).
CORNER = 0.5


class VismatchConfig(PnpConfig):
    """`--set matcher=roma --set references=3` changes it."""

    matcher: str = Field("superpoint-lightglue", description="Name of a matcher of vismatch.")
    device: str = Field("cpu", description="Device of torch.")
    references: int = Field(5, ge=1, description="Number of map photographs to match.")
    max_features: int = Field(2048, ge=1, description="Largest number of keypoints of an image.")
    longest_px: int = Field(
        1024, ge=64, description="Longer side to which larger photographs are resized, pixels."
    )


class Vismatch:
    name = "vismatch"
    weights_sha256 = None  # vismatch downloads them; the name of the matcher says which

    def __init__(self, config: VismatchConfig) -> None:
        self.config = config

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        self._matcher = load_matcher(self.config)
        self._map, self._images = sparse_map, images
        self._sift = Sift(RETRIEVAL_FEATURES)
        with open_cache(sparse_map, images, cache) as map_cache:
            features = map_features(map_cache, self._sift)

        def describe(row: int) -> NDArray[np.float32]:
            return self._sift.unit(features[sparse_map.names[row]].descriptors).numpy()

        count = len(sparse_map.names)
        self._references = References.build(sparse_map, LazyDescriptors(describe, count))

    def localize(self, query: Query) -> Estimate:
        if reason := query_error(query):
            return Estimate(Status.FAILED, reason=reason)
        clock, config = Stopwatch(), self.config
        with clock.stage("retrieval"):
            chosen = self._references.choose(
                query,
                config.references,
                lambda: self._sift.unit(self._sift(query.image).descriptors).numpy(),
                tilt_invariant=False,
            )
        if not len(chosen):
            return Estimate(Status.FAILED, seconds=clock.seconds, reason="no reference")
        estimates = []
        for start in list_initial_poses(query.prior, self._map, chosen):
            with clock.stage("matching"):
                own = self._view(query.image, query.camera, start)
                names = [self._map.names[int(row)] for row in chosen]
                xy, xyz = zip(*(self._lift(own, name) for name in names), strict=True)
            matches = np.concatenate(xy), np.concatenate(xyz)
            estimates.append(solve_pose(query, *matches, config, clock))
        return max(estimates, key=lambda estimate: estimate.inliers)

    def _view(self, rgb: NDArray[np.uint8], camera: Camera, pose: Pose) -> WarpedImage:
        """Rotate a photograph north up, because few networks are rotation-invariant."""
        scale = min(1.0, self.config.longest_px / max(camera.width, camera.height))
        return warp_image(rgb, camera, north_angle(pose.rotation.numpy()), scale)

    def _lift(self, own: WarpedImage, name: str) -> tuple[NDArray[Any], NDArray[Any]]:
        """Match the query to a map photograph; return its pixels (K, 2) and their points (K, 3)."""
        image = self._map.images[name]
        rgb = read_rgb(self._images / name, image.camera)
        views = own, self._view(rgb, image.camera, image.pose)
        try:
            matches = self._matcher(*(as_tensor(view.picture) for view in views))
        except Exception as error:  # some matchers raise on a picture without texture
            log.warning("%s failed on %s: %r", self.config.matcher, name, error)
            return np.empty((0, 2)), np.empty((0, 3))
        # Not inlier_kpts: they fit a homography, which excludes objects above the ground.
        pixels = [
            np.asarray(matches[key], np.float64).reshape(-1, 2) + CORNER
            for key in ("matched_kpts0", "matched_kpts1")
        ]
        kept = np.all([view.shows(xy) for view, xy in zip(views, pixels, strict=True)], axis=0)
        xy, xy_map = (view.in_photograph(xy[kept]) for view, xy in zip(views, pixels, strict=True))
        xyz = interpolate_points(xy_map, image, self._map.xyz)
        seen = np.isfinite(xyz).all(1)
        return xy[seen], xyz[seen]


def as_tensor(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return a picture in the format of vismatch: (3, H, W), from 0 to 1."""
    return np.ascontiguousarray(rgb.transpose(2, 0, 1), np.float32) / 255


def load_matcher(config: VismatchConfig) -> Any:
    """Load a matcher; its weights are downloaded the first time."""
    try:
        library = importlib.import_module("vismatch")
    except ImportError as error:
        raise InputError(
            f"the package vismatch cannot be imported ({error}): pip install vismatch"
        ) from None
    try:
        return library.get_matcher(
            config.matcher, device=config.device, max_num_keypoints=config.max_features
        )
    except Exception as error:  # raised by any of fifty libraries
        what = f"matcher={config.matcher} on device={config.device}"
        raise InputError(
            f"vismatch cannot load {what}: {str(error).partition(chr(10))[0]}"
        ) from error


def make(overrides: dict[str, Any]) -> Vismatch:
    return Vismatch(load_config(VismatchConfig, None, overrides))
