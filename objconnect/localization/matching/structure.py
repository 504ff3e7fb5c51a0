"""Structure-based localization: PnP from matches to 3D points of the reference images.

All methods with local features use it. A method is an extractor, a matcher and a configuration.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from objconnect.localization.cache.map_cache import MapCache, open_cache
from objconnect.localization.cache.store import Rows
from objconnect.localization.initial_poses import list_angles, list_initial_poses
from objconnect.localization.matching.features import Extractor, map_features
from objconnect.localization.matching.lifting import find_observations, interpolate_points
from objconnect.localization.matching.matcher import Keypoints, Matcher, transform_keypoints
from objconnect.localization.matching.pnp import MIN_MATCHES, PnpConfig, solve_pose
from objconnect.localization.matching.retrieval import NO_REFERENCE, LazyDescriptors, References
from objconnect.localization.resolution import map_resolution, metres_per_pixel, scale_to
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import north_angle
from objconnect.scene.localizer import Estimate, MapPart, Query, Status, Stopwatch, query_error
from objconnect.scene.maps.features import Features
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.progress import progress_within
from objconnect.scene.storage.lru_cache import LruCache, free_cache_bytes

# Version of the format of the cache files. Files of another version are not used.
_FORMAT = 3
_ARRAYS = ("points", "xyz", "xy", "descriptors")


class NoKeypointOnPointError(InputError):
    """No keypoint of a map's photographs lies at a map point.

    The map was then built from other keypoints or other photographs.
    """


class MatchingConfig(PnpConfig):
    """Options of a structure-based localizer with any matcher."""

    references: int = Field(
        5, ge=1, description="Number of reference images that are matched with the query."
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


class StructureConfig(MatchingConfig):
    """Options of a structure-based localizer that matches nearest neighbours."""

    ratio: float = Field(
        0.8,
        gt=0,
        le=1,
        description="Largest ratio of nearest to second nearest descriptor distance.",
    )


class StructureLocalizer:
    """Localizes images by matches to 3D points. Implements ``Localizer``."""

    def __init__(
        self, config: MatchingConfig, extractor: Extractor, matcher: Matcher, interpolate: bool
    ) -> None:
        """Create the localizer; ``prepare`` reads the map.

        Args:
            config: configuration of the method.
            extractor: extractor of the features.
            matcher: matcher of the features.
            interpolate: whether 3D points of keypoints are interpolated between the map's
                observations, as is necessary for features that the map was not built from.
        """
        self.config = config
        self._extractor = extractor
        self._matcher = matcher
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
        with open_cache(sparse_map, images, cache) as map_cache:
            self.prepare_from(map_cache)

    def prepare_from(self, map_cache: MapCache) -> None:
        """Prepare the map of a cache, as ``prepare`` does."""
        sparse_map, unit = map_cache.sparse_map, self._extractor.unit
        features = map_features(map_cache, self._extractor)
        store = map_cache.store(
            f"{self.name}-points",
            _FORMAT,
            *self._extractor.identity,
            self._interpolate,
            rows=lambda _: self._lift(map_cache, features),
        )
        self._map = sparse_map

        def read_lifted(row: int) -> _LiftedKeypoints:
            return _LiftedKeypoints(**store.arrays(row, _ARRAYS))

        def describe(row: int) -> NDArray[np.float32]:
            return unit(features[sparse_map.names[row]].descriptors).numpy()

        self._lifted_keypoints = LruCache(read_lifted, free_cache_bytes(self.config.memory_mb))
        self._resolution = map_resolution(sparse_map, lambda camera: 1.0)
        self._references = References.build(sparse_map, LazyDescriptors(describe, len(store)))

    def prepare_part(self, sparse_map: SparseMap, images: Path, cache: Path, part: MapPart) -> None:
        """Fill the cache for a part of the photographs; see ``PreparesParts``."""
        map_features(MapCache.of(sparse_map, images, cache, part), self._extractor)

    def _lift(self, map_cache: MapCache, features: Mapping[str, Features]) -> Rows:
        """Yield, for each photograph, its keypoints that have a 3D point.

        The point is one of the map, or interpolated.
        """
        sparse_map = map_cache.sparse_map
        end, lifted_count = len(sparse_map.xyz), 0
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
            lifted_count += len(lifted)
            xy, descriptors = keypoints.xy[lifted], keypoints.descriptors[lifted]
            yield "", vars(_LiftedKeypoints(points, xyz, xy, descriptors))
        if not lifted_count and _is_observed(sparse_map):
            raise NoKeypointOnPointError(
                f"no keypoint of the photographs in {map_cache.images} lies at a point of the map: "
                "give the photographs that the map was built from, in their original size"
            )

    def localize(self, query: Query) -> Estimate:
        """Extract features, choose reference images, match, and estimate the pose by PnP.

        Features that are not rotation-invariant are extracted from the image rotated for each
        initial pose. The estimate with the most inliers is returned.
        """
        if reason := query_error(query):
            return Estimate(Status.FAILED, reason=reason)
        clock, extractor = Stopwatch(), self._extractor
        pictures = _Pictures(extractor, query, clock)
        if extractor.rotation_invariant:
            _ = pictures.original  # extracted here, outside the stage of retrieval
        with clock.stage("retrieval"):
            reference_rows = self._references.choose(
                query,
                self.config.references,
                lambda: self._describe(query, pictures),
                tilt_invariant=extractor.tilt_invariant,
            )
        if not len(reference_rows):
            return Estimate(Status.FAILED, seconds=clock.seconds, reason=NO_REFERENCE)
        if extractor.rotation_invariant:
            return self._solve(query, pictures.original, reference_rows, clock)
        estimates: list[Estimate] = []
        poses = list_initial_poses(
            query.prior, self._map, reference_rows, headings=extractor.headings
        )
        with progress_within("starts matched", len(poses)) as advance:
            for start in poses:
                angle = north_angle(start.rotation.numpy())
                picture = pictures.rotate(angle, self._scale(query, reference_rows, start))
                estimates.append(self._solve(query, picture, reference_rows, clock))
                advance(len(estimates))
        return max(estimates, key=lambda estimate: estimate.inliers)

    def find_similar(self, query: Query, count: int) -> NDArray[np.int64]:
        """Return rows of the ``count`` photographs most similar to a query, best first."""
        descriptors = self._extractor.unit(self._extractor(query.image).descriptors).numpy()
        return self._references.index.rank(descriptors, count)

    def _describe(self, query: Query, pictures: _Pictures) -> list[NDArray[np.float32]]:
        """Return unit descriptors (n, D) of the query for retrieval, an array per heading tried."""
        unit, headings = self._extractor.unit, self._extractor.headings
        if not headings:
            return [unit(pictures.original.features.descriptors).numpy()]
        angles = list_angles(headings)
        if query.prior is not None and query.prior.has_heading:
            angles = [north_angle(np.asarray(query.prior.cam_from_world_rotation))]
        rotated = (pictures.rotate(angle, 1.0) for angle in angles)
        return [unit(picture.features.descriptors).numpy() for picture in rotated]

    def _scale(self, query: Query, reference_rows: NDArray[np.int64], start: Pose) -> float:
        """Return the scale that gives the query the map's resolution if a start is right."""
        xyz = np.concatenate([self._lifted_keypoints(int(row)).xyz for row in reference_rows])
        resolution = metres_per_pixel(start, query.camera, xyz)
        return scale_to(self._resolution, resolution, self.config.max_magnification)

    def _solve(
        self, query: Query, picture: _Picture, reference_rows: NDArray[np.int64], clock: Stopwatch
    ) -> Estimate:
        """Match features to the chosen photographs and estimate the pose."""
        with clock.stage("matching"):
            keypoints, xyz = self._correspondences(picture.keypoints(query.camera), reference_rows)
        xy = picture.features.xy[keypoints].astype(np.float64)
        return solve_pose(query, xy, xyz, self.config, clock)

    def _correspondences(
        self, query: Keypoints, references: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Match keypoints to all reference images.

        Returns:
            Unique pairs: rows of the query's keypoints (K,) and their points (K, 3), world metres.
        """
        all_lifted = [self._lifted_keypoints(int(reference)) for reference in references]
        images = [self._map.images[self._map.names[int(reference)]] for reference in references]
        rotates = not self._extractor.rotation_invariant
        reference_keypoints = [
            transform_keypoints(
                lifted.xy,
                lifted.descriptors,
                image.camera,
                north_angle(image.cam_from_world[:3, :3]) if rotates else 0.0,
            )
            for lifted, image in zip(all_lifted, images, strict=True)
        ]
        matches, points = [], []
        matched = self._matcher(query, reference_keypoints)
        for lifted, pairs in zip(all_lifted, matched, strict=True):
            matches.append(np.stack([pairs[:, 0], lifted.points[pairs[:, 1]]], -1))
            points.append(lifted.xyz[pairs[:, 1]])
        unique, first = np.unique(np.concatenate(matches), axis=0, return_index=True)
        return unique[:, 0], np.concatenate(points)[first]


@dataclass(frozen=True)
class _Picture:
    """Features of a query's picture that was rotated and resized.

    Attributes:
        features: the features, in pixels of the query.
        angle: counter-clockwise rotation of the picture, rad.
        scale: factor by which the picture was resized.
    """

    features: Features
    angle: float = 0.0
    scale: float = 1.0

    def keypoints(self, camera: Camera) -> Keypoints:
        """Return the keypoints in the rotated picture, in the form that a matcher takes."""
        features = self.features
        return transform_keypoints(
            features.xy, features.descriptors, camera, self.angle, self.scale
        )


class _Pictures:
    """Features of a query's picture, extracted once for each rotation and scale."""

    def __init__(self, extractor: Extractor, query: Query, clock: Stopwatch) -> None:
        self._extractor, self._query, self._clock = extractor, query, clock
        self._pictures: dict[tuple[float, float], _Picture] = {}

    @cached_property
    def original(self) -> _Picture:
        """Features of the picture as it is."""
        with self._clock.stage("features"):
            return _Picture(self._extractor(self._query.image))

    def rotate(self, angle: float, scale: float) -> _Picture:
        """Return features of the picture rotated counter-clockwise by ``angle`` (rad), resized."""
        key = round(angle, 4), round(scale, 4)
        if key not in self._pictures:
            with self._clock.stage("features"):
                query = self._query
                features = self._extractor.extract_warped(query.image, query.camera, angle, scale)
            self._pictures[key] = _Picture(features, angle, scale)
        return self._pictures[key]


@dataclass(frozen=True)
class _LiftedKeypoints:
    """The N keypoints of a photograph of the map that have a 3D point.

    Attributes:
        points: (N,) ids of the points; several photographs may observe one point.
        xyz: (N, 3) the points, world metres.
        xy: (N, 2) float32 COLMAP pixels of the keypoints.
        descriptors: (N, D) as extracted. As unit vectors in float32 they would take two to
            thirty-two times the memory.
    """

    points: NDArray[np.int64]
    xyz: NDArray[np.float64]
    xy: NDArray[np.float32]
    descriptors: NDArray[Any]

    @property
    def nbytes(self) -> int:
        return sum(each.nbytes for each in (self.points, self.xyz, self.xy, self.descriptors))


def _is_observed(sparse_map: SparseMap) -> bool:
    """Return whether the photographs of a map observe enough points for a pose."""
    observed = [image.point_rows for image in sparse_map.images.values()]
    rows = np.unique(np.concatenate(observed))
    return int((rows >= 0).sum()) >= MIN_MATCHES
