"""The localizer ``epipolar``: poses from essential matrices, without 3D points.

Each reference image gives the query's attitude and the ray from the image to the query. The rays of
two or more images intersect in the query's position. The pose then minimises the distances of the
matches to their epipolar lines in all images together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from objconnect.localization.cache.map_cache import open_cache
from objconnect.localization.matching.features import Extractor, map_features
from objconnect.localization.matching.retrieval import LazyDescriptors, References
from objconnect.localization.matching.sift import Sift
from objconnect.scene.colmap.relative_pose import estimate_relative_pose
from objconnect.scene.config import Config
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.rays import Rays
from objconnect.scene.geometry.sampson import Matches, refine
from objconnect.scene.localizer import Estimate, PoseSource, Query, Status, Stopwatch, query_error
from objconnect.scene.maps.features import Features
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.storage.lru_cache import LruCache, free_cache_bytes

# Minimum number of inliers of a reference image. A relative pose is computed from five matches. If
# fifteen more agree with it, this is not by chance.
_MIN_INLIERS: Final = 20
# Two reference images give a position, at which their rays intersect; the first one also gives an
# attitude. A third one agrees with them if its ray passes the position by less than this angle and
# its attitude differs by less than this.
_AGREE_DEG: Final = 5.0
# Two rays determine the position only if the angle between them is at least this.
_MIN_ANGLE_DEG: Final = 5.0


class EpipolarConfig(Config):
    """Options of the epipolar localizer."""

    references: int = Field(
        8, ge=2, description="Number of reference images that are matched with the query."
    )
    ratio: float = Field(
        0.8, gt=0, le=1, description="Ratio of nearest to second nearest descriptor distance."
    )
    max_error_px: float = Field(2.0, gt=0, description="Inlier threshold of the Sampson error, px.")
    max_features: int = Field(8192, ge=100, description="Maximum number of features of an image.")
    memory_mb: int = Field(
        2048,
        ge=1,
        description="Memory of the whole process, MB; features of the map stay in memory as far as "
        "there is room.",
    )
    seed: int = Field(0, description="Random seed of RANSAC.")


@dataclass(frozen=True)
class _MapFeatures:
    """Keypoints (N, 2) of a photograph of the map with descriptors of unit length."""

    xy: NDArray[np.float32]
    unit: Tensor

    @property
    def nbytes(self) -> int:
        return self.xy.nbytes + self.unit.nbytes


class EpipolarLocalizer:
    """Localizes images by relative poses. Implements ``objconnect.scene.localizer.Localizer``."""

    name = "epipolar"
    weights_sha256: str | None = None

    def __init__(self, config: EpipolarConfig) -> None:
        self.config = config
        self._sift: Extractor = Sift(config.max_features)

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Extract the features of the map's photographs."""
        self._map = sparse_map
        unit = self._sift.unit
        with open_cache(sparse_map, images, cache) as map_cache:
            features = map_features(map_cache, self._sift)

        def extract(name: str) -> _MapFeatures:
            keypoints = features[name]
            return _MapFeatures(keypoints.xy, unit(keypoints.descriptors))

        def describe(row: int) -> NDArray[np.float32]:
            return unit(features[sparse_map.names[row]].descriptors).numpy()

        self._map_features = LruCache(extract, free_cache_bytes(self.config.memory_mb))
        count = len(sparse_map.names)
        self._references = References.build(sparse_map, LazyDescriptors(describe, count))

    def localize(self, query: Query) -> Estimate:
        """Match reference images, estimate relative poses, intersect rays and refine."""
        if reason := query_error(query):
            return Estimate(Status.FAILED, reason=reason)
        clock = Stopwatch()
        with clock.stage("features"):
            features = self._sift(query.image)
            unit = self._sift.unit(features.descriptors)
        with clock.stage("retrieval"):
            rows = self._references.choose(query, self.config.references, unit.numpy)
            references = [self._map.images[self._map.names[row]] for row in rows]
        with clock.stage("relative poses"):
            attempts = [self._relate(query, features, unit, image) for image in references]
            relations = [each for each in attempts if each is not None]
        with clock.stage("pose"):
            rays = _rays(relations)
            agreeing = rays.consensus(_AGREE_DEG, _MIN_ANGLE_DEG)
            if not len(agreeing):
                reason = self._explain_failure(rays, len(references))
                return Estimate(Status.FAILED, seconds=clock.seconds, reason=reason)
            chosen = rays[agreeing]
            rotation = chosen.attitude()
            start = Pose(
                torch.from_numpy(rotation), torch.from_numpy(-rotation @ chosen.intersect())
            )
            used = [relations[row][0] for row in agreeing]
            focal = float(np.mean(query.camera.focal))
            refined = refine(start, used, focal)
        return Estimate(
            Status.OK,
            refined.pose,
            refined.covariance,
            inliers=sum(len(matches.query_rays) for matches in used),
            iterations=refined.iterations,
            seconds=clock.seconds,
            by=PoseSource.MATCHES,
        )

    def _relate(
        self, query: Query, features: Features, unit: Tensor, image: MapImage
    ) -> tuple[Matches, Pose] | None:
        """Return the matches and ``query_from_reference`` of an image; None if too few agree."""
        reference = self._map_features(image.name)
        matches = self._sift.match(unit, reference.unit, self.config.ratio)
        if len(matches) < _MIN_INLIERS:
            return None
        query_xy = features.xy[matches[:, 0]].astype(np.float64)
        reference_xy = reference.xy[matches[:, 1]].astype(np.float64)
        relative = estimate_relative_pose(
            reference_xy,
            query_xy,
            image.camera,
            query.camera,
            self.config.max_error_px,
            self.config.seed,
        )
        if relative is None:
            return None
        query_rays, query_valid = query.camera.unproject(torch.from_numpy(query_xy))
        reference_rays, reference_valid = image.camera.unproject(torch.from_numpy(reference_xy))
        kept = torch.from_numpy(relative.inliers) & query_valid & reference_valid
        if int(kept.sum()) < _MIN_INLIERS:
            return None
        return Matches(image.pose, query_rays[kept], reference_rays[kept]), relative.b_from_a

    def _explain_failure(self, rays: Rays, tried: int) -> str:
        if len(rays) < 2:
            return f"{len(rays)} of {tried} references match the query, 2 are needed"
        if rays.widest_angle_deg() < _MIN_ANGLE_DEG:
            return (
                f"the rays of {len(rays)} references differ in direction by at most "
                f"{rays.widest_angle_deg():.1f}°, {_MIN_ANGLE_DEG:g}° are needed"
            )
        return f"no two of {len(rays)} references agree on the pose of the query"


def _rays(relations: Sequence[tuple[Matches, Pose]]) -> Rays:
    """Return the rays from reference images to the query, with the query's attitude from each."""
    origins, directions, rotations = (
        np.zeros((len(relations), 3)),
        np.zeros((len(relations), 3)),
        np.zeros((len(relations), 3, 3)),
    )
    for k, (matches, query_from_reference) in enumerate(relations):
        rotation = matches.reference.rotation
        origins[k] = matches.reference.centre()
        directions[k] = rotation.T @ query_from_reference.centre()
        rotations[k] = query_from_reference.rotation @ rotation
    return Rays(origins, directions, rotations)
