"""SIFT against the nearest photographs of the map, 2D-3D lifting and PnP: the classical pipeline.

Features are COLMAP's DoG SIFT with RootSIFT descriptors (Arandjelovic and Zisserman, CVPR 2012).
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from baselines.retrieval import VladIndex, nearest_by_position
from scene.colmap import SiftExtractor, SiftOptions, estimate_absolute_pose, extract_sift
from scene.config import Config
from scene.errors import InputError
from scene.features import Features, read_features, unit_descriptors, write_features
from scene.files import sha256_of
from scene.images import check_photographs
from scene.localizer import Estimate, Query, Status, Stopwatch
from scene.matching import match
from scene.progress import progress_bar
from scene.sparse_map import MapImage, SparseMap

# A keypoint carries the 3D point of a map observation within this distance (px).
_LIFT_RADIUS = 1.0
_MIN_MATCHES = 4


class SiftConfig(Config):
    """Options of the sift localizer.

    Attributes:
        references: photographs of the map matched against the query.
        ratio: of nearest to second nearest descriptor distance.
        max_error_px: inlier threshold of PnP.
        min_inliers: fewer count as a failure.
        max_features: per image.
        use_gnss: let a position prior of known sigma take part in the refinement.
        seed: of RANSAC.
    """

    references: int = Field(5, ge=1)
    ratio: float = Field(0.8, gt=0, le=1)
    max_error_px: float = Field(4.0, gt=0)
    min_inliers: int = Field(12, ge=4)
    max_features: int = Field(8192, ge=100)
    use_gnss: bool = True
    seed: int = 0


class SiftLocalizer:
    """See the module. Implements ``scene.localizer.Localizer``."""

    name = "sift"
    weights_sha256: str | None = None

    def __init__(self, config: SiftConfig) -> None:
        self.config = config
        self._options = SiftOptions(max_features=config.max_features)
        self._extract = SiftExtractor(self._options)

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Extract the features of the map's photographs and tie them to its points."""
        features = map_features(sparse_map, images, self._options, cache)
        self._map = sparse_map
        self._centres = sparse_map.centres
        self._row = {name: row for row, name in enumerate(sparse_map.names)}
        descriptors = [unit_descriptors(features[name]) for name in sparse_map.names]
        # Only keypoints with a 3D point can vote for a pose.
        self._lifted: list[tuple[NDArray[np.int64], torch.Tensor]] = []
        for name, unit in zip(sparse_map.names, descriptors, strict=True):
            rows = _points_of_keypoints(features[name], sparse_map.images[name])
            kept = np.flatnonzero(rows >= 0)
            self._lifted.append((rows[kept], unit[kept]))
        if not any(len(rows) for rows, _ in self._lifted):
            raise InputError(
                f"no keypoint of the photographs in {images} lies where the map has a point: they "
                "are not the photographs the map was built from, or were resized since"
            )
        self._index = VladIndex.build([unit.numpy() for unit in descriptors])

    def localize(self, query: Query) -> Estimate:
        """Extract, choose references, match, lift and solve."""
        clock = Stopwatch()
        with clock.stage("features"):
            features = self._extract(query.image)
            descriptors = unit_descriptors(features)
        with clock.stage("retrieval"):
            references = self._references(query, descriptors)
        with clock.stage("matching"):
            xy, rows = self._correspondences(features, descriptors, references)
        if len(rows) < _MIN_MATCHES:
            reason = f"{len(rows)} matches to the map, {_MIN_MATCHES} are needed"
            return Estimate(Status.FAILED, seconds=clock.seconds, reason=reason)
        with clock.stage("pose"):
            gnss = query.prior if self.config.use_gnss else None
            result = estimate_absolute_pose(
                xy,
                self._map.xyz[rows],
                query.camera,
                self.config.max_error_px,
                gnss.position if gnss else None,
                gnss.position_sigma if gnss else None,
                self.config.seed,
            )
        inliers = int(result.inliers.sum()) if result else 0
        if result is None or inliers < self.config.min_inliers:
            reason = f"{inliers} of {len(rows)} matches agree, {self.config.min_inliers} are needed"
            return Estimate(Status.FAILED, inliers=inliers, seconds=clock.seconds, reason=reason)
        return Estimate(
            Status.OK,
            result.cam_from_world,
            result.covariance,
            inliers=inliers,
            seconds=clock.seconds,
        )

    def _references(self, query: Query, descriptors: torch.Tensor) -> NDArray[np.int64]:
        if query.references is not None:
            return np.array([self._row[name] for name in query.references], np.int64)
        if query.prior is not None:
            return nearest_by_position(self._centres, query.prior.position, self.config.references)
        return self._index.rank(descriptors.numpy(), self.config.references)

    def _correspondences(
        self, features: Features, descriptors: torch.Tensor, references: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Unique (query keypoint, map point) pairs over all references: xy (K, 2), rows (K,)."""
        found = []
        for reference in references:
            rows, lifted = self._lifted[reference]
            pairs = match(descriptors, lifted, self.config.ratio)
            found.append(np.stack([pairs[:, 0], rows[pairs[:, 1]]], -1))
        unique = np.unique(np.concatenate(found), axis=0)
        return features.xy[unique[:, 0]].astype(np.float64), unique[:, 1]


def _points_of_keypoints(features: Features, image: MapImage) -> NDArray[np.int64]:
    """The map point seen at each keypoint, -1 where the map has none there. (N,)."""
    seen = image.point_rows >= 0
    rows = np.full(len(features.xy), -1, np.int64)
    if not seen.any() or not len(rows):
        return rows
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    observed = image.xy[seen].astype(np.float32)
    for hit in matcher.match(features.xy, observed):
        if hit.distance <= _LIFT_RADIUS:
            rows[hit.queryIdx] = image.point_rows[seen][hit.trainIdx]
    return rows


def map_features(
    sparse_map: SparseMap, images: Path, options: SiftOptions, cache: Path | None
) -> dict[str, Features]:
    """Features of the map's photographs, read from the cache when it holds them.

    Raises:
        InputError: a photograph is missing, broken, or not of its camera's size.
    """
    check_photographs(images, {name: sparse_map.images[name].camera for name in sparse_map.names})
    path = None
    if cache is not None:
        photographs = [sha256_of(images / name) for name in sparse_map.names]
        key = hashlib.sha256(f"{sparse_map.sha256} {photographs} {options}".encode()).hexdigest()
        path = cache / f"sift-{key[:16]}.h5"
        if path.is_file():
            return read_features(path)
    with progress_bar("map features", len(sparse_map.names)) as advance:
        features = extract_sift(images, sparse_map.names, options, on_progress=advance)
    if path is not None:
        write_features(path, features)
    return features
