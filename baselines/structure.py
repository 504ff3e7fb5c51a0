"""Localization by structure: matches to photographs of the map, lifted to 3D points, give a pose.

One pipeline for every kind of local feature; a method is an extractor and a configuration.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from baselines.features import Extractor, map_features
from baselines.lifting import interpolated_points, observed_points
from baselines.resolution import metres_per_pixel, of_map, scale_to
from baselines.retrieval import References
from baselines.starts import starts
from baselines.views import north
from scene.colmap import estimate_absolute_pose
from scene.config import Config
from scene.errors import InputError
from scene.features import Features
from scene.localizer import Estimate, Query, Status, Stopwatch, fault
from scene.pose import Pose
from scene.sparse_map import SparseMap

_MIN_MATCHES = 4
# Pictures are magnified by so much at most: there is no more to be seen in them.
_LARGEST = 2.0


class StructureConfig(Config):
    """Options of a structure-based localizer.

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


class StructureLocalizer:
    """See the module. Implements ``scene.localizer.Localizer``."""

    def __init__(self, config: StructureConfig, extractor: Extractor, interpolate: bool) -> None:
        """
        Args:
            config: of the method.
            extractor: of its features.
            interpolate: lift keypoints between the map's observations too, which a kind of feature
                needs that the map was not built from.
        """
        self.config = config
        self._extractor = extractor
        self._interpolate = interpolate

    @property
    def name(self) -> str:
        """That of the features."""
        return self._extractor.name

    @property
    def weights_sha256(self) -> str | None:
        """That of the features."""
        return self._extractor.weights_sha256

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Extract the features of the map's photographs and tie them to its points."""
        features = map_features(sparse_map, images, self._extractor, cache)
        descriptors = [self._extractor.unit(features[name]) for name in sparse_map.names]
        # Points that keypoints carry: those of the map, or one for each keypoint.
        tables, end = [sparse_map.xyz], len(sparse_map.xyz)
        # Only keypoints with a 3D point can vote for a pose.
        self._lifted: list[tuple[NDArray[np.int64], torch.Tensor]] = []
        for name, unit in zip(sparse_map.names, descriptors, strict=True):
            image, xy = sparse_map.images[name], features[name].xy
            if self._interpolate:
                points = interpolated_points(xy, image, sparse_map.xyz)
                kept = np.flatnonzero(np.isfinite(points).all(1))
                rows = np.arange(end, end + len(kept))
                tables.append(points[kept])
                end += len(kept)
            else:
                carried = observed_points(xy, image)
                kept = np.flatnonzero(carried >= 0)
                rows = carried[kept]
            self._lifted.append((rows, unit[kept]))
        if not any(len(rows) for rows, _ in self._lifted) and _is_observed(sparse_map):
            raise InputError(
                f"no keypoint of the photographs in {images} lies where the map has a point: they "
                "are not the photographs the map was built from, or were resized since"
            )
        self._xyz = np.concatenate(tables)
        self._map = sparse_map
        self._resolution = of_map(sparse_map, lambda camera: 1.0)
        self._references = References.build(sparse_map, [unit.numpy() for unit in descriptors])

    def localize(self, query: Query) -> Estimate:
        """Extract, choose references, match, lift and solve.

        Features that are not found again in turned pictures are those of every picture that the
        likely starts give; the one with most inliers counts.
        """
        if reason := fault(query):
            return Estimate(Status.FAILED, reason=reason)
        clock = Stopwatch()

        @cache
        def as_taken() -> Features:
            with clock.stage("features"):
                return self._extractor(query.image)

        turned = self._extractor.turned
        if turned:
            as_taken()
        with clock.stage("retrieval"):
            chosen = self._references.choose(
                query, self.config.references, lambda: self._extractor.unit(as_taken()).numpy()
            )
        if not len(chosen):
            return Estimate(Status.FAILED, seconds=clock.seconds, reason="no reference")
        if turned:
            return self._solved(query, as_taken(), chosen, clock)
        found = []
        for start in starts(query.prior, self._map, chosen):
            with clock.stage("features"):
                features = self._seen(query, start)
            found.append(self._solved(query, features, chosen, clock))
        return max(found, key=lambda estimate: estimate.inliers)

    def _seen(self, query: Query, start: Pose) -> Features:
        """Features of the query, seen as the photographs were, if a start is right."""
        own = metres_per_pixel(start, query.camera, self._map.xyz)
        scale = scale_to(self._resolution, own, _LARGEST)
        angle = north(start.rotation.numpy())
        return self._extractor.seen(query.image, query.camera, angle, scale)

    def _solved(
        self, query: Query, features: Features, chosen: NDArray[np.int64], clock: Stopwatch
    ) -> Estimate:
        """Match, lift and solve."""
        with clock.stage("matching"):
            keypoints, rows = self._correspondences(self._extractor.unit(features), chosen)
        if len(rows) < _MIN_MATCHES:
            reason = f"{len(rows)} matches to the map, {_MIN_MATCHES} are needed"
            return Estimate(Status.FAILED, seconds=clock.seconds, reason=reason)
        with clock.stage("pose"):
            gnss = query.prior if self.config.use_gnss else None
            result = estimate_absolute_pose(
                features.xy[keypoints].astype(np.float64),
                self._xyz[rows],
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

    def _correspondences(
        self, descriptors: torch.Tensor, references: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Unique (query keypoint, point) pairs over all references, (K,) rows of each."""
        found = []
        for reference in references:
            rows, lifted = self._lifted[reference]
            pairs = self._extractor.match(descriptors, lifted, self.config.ratio)
            found.append(np.stack([pairs[:, 0], rows[pairs[:, 1]]], -1))
        unique = np.unique(np.concatenate(found), axis=0)
        return unique[:, 0], unique[:, 1]


def _is_observed(sparse_map: SparseMap) -> bool:
    """Whether the photographs of a map see enough of its points for a pose."""
    seen = [image.point_rows for image in sparse_map.images.values()]
    rows = np.unique(np.concatenate(seen))
    return int((rows >= 0).sum()) >= _MIN_MATCHES
