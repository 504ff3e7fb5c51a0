"""Structure-based localization: PnP from matches to 3D points of the reference images.

All local features use this pipeline. A method is an extractor and a configuration.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache as cached
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from objconnect.localization.cache.map_cache import MapCache, open_cache
from objconnect.localization.cache.store import Rows
from objconnect.localization.matching.features import Extractor, map_features
from objconnect.localization.matching.lifting import find_observations, interpolate_points
from objconnect.localization.matching.pnp import MIN_MATCHES, PnpConfig, solve_pose
from objconnect.localization.matching.retrieval import OnDemand, References
from objconnect.localization.resolution import map_resolution, metres_per_pixel, scale_to
from objconnect.localization.starts import starts
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import north_angle
from objconnect.scene.localizer import Estimate, MapPart, Query, Status, Stopwatch, query_error
from objconnect.scene.maps.features import Features
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.progress import progress_within
from objconnect.scene.storage.lru_cache import LruCache, room

# Version of the cache files. Another number rebuilds them.
_FORMAT = 2
_ARRAYS = ("points", "xyz", "descriptors")


class NoKeypointOnPointError(InputError):
    """No keypoint of a map's photographs lies at a map point: the map is not built from them."""


class StructureConfig(PnpConfig):
    """Options of a structure-based localizer."""

    references: int = Field(
        5, ge=1, description="Number of reference images that are matched with the query."
    )
    ratio: float = Field(
        0.8, gt=0, le=1, description="Ratio of nearest to second nearest descriptor distance."
    )
    max_features: int = Field(8192, ge=100, description="Maximum number of features of an image.")
    memory_mb: int = Field(
        2048,
        ge=1,
        description="Memory of the whole process, MB; features of the map stay in memory as far as "
        "there is room.",
    )
    max_magnification: float = Field(
        2.0,
        ge=1,
        description="Largest factor by which images are magnified to the map's resolution, for "
        "features that are not scale-invariant.",
    )


class StructureLocalizer:
    """Localizes images by matches to 3D points. Implements ``Localizer``."""

    def __init__(self, config: StructureConfig, extractor: Extractor, interpolate: bool) -> None:
        """Keep the configuration and the extractor.

        Args:
            config: configuration of the method.
            extractor: extractor of its features.
            interpolate: whether 3D points of keypoints are interpolated between the map's
                observations, for features that the map was not built from.
        """
        self.config = config
        self._extractor = extractor
        self._interpolate = interpolate

    @property
    def name(self) -> str:
        """Return the name of the features."""
        return self._extractor.name

    @property
    def weights_sha256(self) -> str | None:
        """Return the digest of the features' weights."""
        return self._extractor.weights_sha256

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Extract the features of the map's photographs and associate them with its points."""
        with open_cache(sparse_map, images, cache) as kept:
            self.prepare_from(kept)

    def prepare_from(self, kept: MapCache) -> None:
        """Prepare the map of a cache."""
        sparse_map, unit = kept.sparse_map, self._extractor.unit
        features = map_features(kept, self._extractor)
        store = kept.store(
            f"{self.name}-points",
            _FORMAT,
            *self._extractor.identity,
            self._interpolate,
            rows=lambda _: self._lift(kept, features),
        )
        self._map = sparse_map

        def lift_features(row: int) -> _Lifted:
            return _Lifted(**store.arrays(row, _ARRAYS))

        def describe(row: int) -> NDArray[np.float32]:
            return unit(features[sparse_map.names[row]].descriptors).numpy()

        self._lifted = LruCache(lift_features, room(self.config.memory_mb))
        self._resolution = map_resolution(sparse_map, lambda camera: 1.0)
        self._references = References.build(sparse_map, OnDemand(describe, len(store)))

    def prepare_part(self, sparse_map: SparseMap, images: Path, cache: Path, part: MapPart) -> None:
        """Fill the cache for a part of the photographs; see ``PreparesParts``."""
        map_features(MapCache.of(sparse_map, images, cache, part), self._extractor)

    def _lift(self, kept: MapCache, features: Mapping[str, Features]) -> Rows:
        """Yield the keypoints with a 3D point, which is one of the map or interpolated."""
        sparse_map = kept.sparse_map
        end, carried = len(sparse_map.xyz), 0
        for name in sparse_map.names:
            image, keypoints = sparse_map.images[name], features[name]
            if self._interpolate:
                xyz = interpolate_points(keypoints.xy, image, sparse_map.xyz)
                lifted = np.flatnonzero(np.isfinite(xyz).all(1))
                points, xyz = np.arange(end, end + len(lifted)), xyz[lifted]
                end += len(lifted)
            else:
                rows = find_observations(keypoints.xy, image)
                lifted = np.flatnonzero(rows >= 0)
                points, xyz = rows[lifted], sparse_map.xyz[rows[lifted]]
            carried += len(lifted)
            yield "", vars(_Lifted(points, xyz, keypoints.descriptors[lifted]))
        if not carried and _is_observed(sparse_map):
            raise NoKeypointOnPointError(
                f"no keypoint of the photographs in {kept.images} lies at a point of the map: give "
                "the photographs that the map was built from, in their original size"
            )

    def localize(self, query: Query) -> Estimate:
        """Extract features, choose reference images, match, and estimate the pose by PnP.

        Features that are not rotation-invariant are extracted from the image rotated for each
        start. The estimate with the most inliers is returned.
        """
        if reason := query_error(query):
            return Estimate(Status.FAILED, reason=reason)
        clock = Stopwatch()

        @cached
        def extract_upright() -> Features:
            with clock.stage("features"):
                return self._extractor(query.image)

        if self._extractor.rotation_invariant:
            extract_upright()
        with clock.stage("retrieval"):
            chosen = self._references.choose(
                query,
                self.config.references,
                lambda: self._extractor.unit(extract_upright().descriptors).numpy(),
            )
        if not len(chosen):
            return Estimate(Status.FAILED, seconds=clock.seconds, reason="no reference")
        if self._extractor.rotation_invariant:
            return self._solve(query, extract_upright(), chosen, clock)
        estimates: list[Estimate] = []
        begin = starts(query.prior, self._map, chosen)
        with progress_within("starts matched", len(begin)) as advance:
            for start in begin:
                with clock.stage("features"):
                    features = self._extract(query, chosen, start)
                estimates.append(self._solve(query, features, chosen, clock))
                advance(len(estimates))
        return max(estimates, key=lambda estimate: estimate.inliers)

    def similar(self, query: Query, count: int) -> NDArray[np.int64]:
        """Return rows of the ``count`` photographs most similar to a query, best first."""
        described = self._extractor.unit(self._extractor(query.image).descriptors).numpy()
        return self._references.index.rank(described, count)

    def _extract(self, query: Query, chosen: NDArray[np.int64], start: Pose) -> Features:
        """Extract features of the query, rotated and resized for a start."""
        around = np.concatenate([self._lifted(int(row)).xyz for row in chosen])
        own = metres_per_pixel(start, query.camera, around)
        scale = scale_to(self._resolution, own, self.config.max_magnification)
        angle = north_angle(start.rotation.numpy())
        return self._extractor.extract_warped(query.image, query.camera, angle, scale)

    def _solve(
        self, query: Query, features: Features, chosen: NDArray[np.int64], clock: Stopwatch
    ) -> Estimate:
        """Match features to the chosen photographs and estimate the pose."""
        with clock.stage("matching"):
            unit = self._extractor.unit(features.descriptors)
            keypoints, xyz = self._correspondences(unit, chosen)
        return solve_pose(query, features.xy[keypoints].astype(np.float64), xyz, self.config, clock)

    def _correspondences(
        self, descriptors: torch.Tensor, references: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Match descriptors to all reference images.

        Returns:
            Unique pairs: rows of the query's keypoints (K,) and their points (K, 3).
        """
        matches, points = [], []
        for reference in references:
            lifted = self._lifted(int(reference))
            unit = self._extractor.unit(lifted.descriptors)
            pairs = self._extractor.match(descriptors, unit, self.config.ratio)
            matches.append(np.stack([pairs[:, 0], lifted.points[pairs[:, 1]]], -1))
            points.append(lifted.xyz[pairs[:, 1]])
        unique, first = np.unique(np.concatenate(matches), axis=0, return_index=True)
        return unique[:, 0], np.concatenate(points)[first]


@dataclass(frozen=True)
class _Lifted:
    """The N keypoints of a photograph of the map that have a 3D point.

    Attributes:
        points: (N,) numbers of their points; several photographs may share one.
        xyz: (N, 3) points, world metres.
        descriptors: (N, D) descriptors as extracted; as unit vectors in float32 they would take two
            to thirty-two times the memory.
    """

    points: NDArray[np.int64]
    xyz: NDArray[np.float64]
    descriptors: NDArray[Any]

    @property
    def nbytes(self) -> int:
        return self.points.nbytes + self.xyz.nbytes + self.descriptors.nbytes


def _is_observed(sparse_map: SparseMap) -> bool:
    """Return whether the photographs of a map observe enough points for a pose."""
    seen = [image.point_rows for image in sparse_map.images.values()]
    rows = np.unique(np.concatenate(seen))
    return int((rows >= 0).sum()) >= MIN_MATCHES
