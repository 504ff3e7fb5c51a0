"""Localization without 3D points: relative poses to photographs of the map from essential matrices.

Each gives the query's attitude and the direction from the photograph to the query; where the rays
of two or more meet, there is the query. The pose then moves to where the matches lie closest to
their epipolar lines in all photographs together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from baselines.features import Extractor, map_features
from baselines.rays import Rays
from baselines.retrieval import OnDemand, References
from baselines.sampson import Matches, refine
from baselines.sift import Sift
from scene.colmap.relative_pose import estimate_relative_pose
from scene.config import Config
from scene.geometry.pose import Pose
from scene.localizer import Estimate, Query, Status, Stopwatch, query_error
from scene.maps.features import Features
from scene.maps.sparse_map import MapImage, SparseMap
from scene.storage.lru_cache import LruCache, room

# A relative pose takes five matches; so many more that agree are no chance.
_LEAST_INLIERS = 8


class EpipolarConfig(Config):
    """Options of the epipolar localizer.

    Attributes:
        references: photographs of the map matched against the query.
        ratio: of nearest to second nearest descriptor distance.
        max_error_px: inlier threshold of the Sampson error.
        min_inliers: a photograph with fewer has no say.
        agree_deg: by how much references may differ on the query's attitude and direction.
        least_angle_deg: rays that cross at less do not say where.
        max_features: per image.
        memory_mb: for the whole process: features of the map stay in memory as far as there is room
            below it (``scene.storage.lru_cache.room``).
        seed: of RANSAC.
    """

    references: int = Field(8, ge=2)
    ratio: float = Field(0.8, gt=0, le=1)
    max_error_px: float = Field(2.0, gt=0)
    min_inliers: int = Field(20, ge=_LEAST_INLIERS)
    agree_deg: float = Field(5.0, gt=0)
    least_angle_deg: float = Field(5.0, gt=0)
    max_features: int = Field(8192, ge=100)
    memory_mb: int = Field(2048, ge=1)
    seed: int = 0


@dataclass(frozen=True)
class _Seen:
    """Keypoints of a photograph of the map, (N, 2), and their descriptors, of unit length."""

    xy: NDArray[np.float32]
    unit: Tensor

    @property
    def nbytes(self) -> int:
        return self.xy.nbytes + self.unit.nbytes


class EpipolarLocalizer:
    """See the module. Implements ``scene.localizer.Localizer``."""

    name = "epipolar"
    weights_sha256: str | None = None

    def __init__(self, config: EpipolarConfig) -> None:
        self.config = config
        self._sift: Extractor = Sift(config.max_features)

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Extract the features of the map's photographs."""
        self._map = sparse_map
        features, unit = map_features(sparse_map, images, self._sift, cache), self._sift.unit

        def seen(name: str) -> _Seen:
            found = features[name]
            return _Seen(found.xy, unit(found.descriptors))

        def described(row: int) -> NDArray[np.float32]:
            return unit(features[sparse_map.names[row]].descriptors).numpy()

        self._seen = LruCache(seen, room(self.config.memory_mb))
        count = len(sparse_map.names)
        self._references = References.build(sparse_map, OnDemand(described, count))

    def localize(self, query: Query) -> Estimate:
        """Extract, choose references, find relative poses, intersect, refine."""
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
            tried = [self._relate(query, features, unit, image) for image in references]
            found = [related for related in tried if related is not None]
        with clock.stage("pose"):
            rays = _rays(found)
            agreeing = rays.consensus(self.config.agree_deg, self.config.least_angle_deg)
            if not len(agreeing):
                reason = self._why_not(rays, len(references))
                return Estimate(Status.FAILED, seconds=clock.seconds, reason=reason)
            chosen = rays[agreeing]
            rotation = chosen.attitude()
            start = Pose(torch.from_numpy(rotation), torch.from_numpy(-rotation @ chosen.meet()))
            used = [found[row][0] for row in agreeing]
            refined = refine(start, used, float(np.mean(query.camera.focal)))
        return Estimate(
            Status.OK,
            refined.pose,
            refined.covariance,
            inliers=sum(len(matches.query_rays) for matches in used),
            iterations=refined.iterations,
            seconds=clock.seconds,
        )

    def _relate(
        self, query: Query, features: Features, unit: Tensor, image: MapImage
    ) -> tuple[Matches, Pose] | None:
        """Matches to one photograph and ``query_from_reference``; None where too few agree."""
        seen = self._seen(image.name)
        matches = self._sift.match(unit, seen.unit, self.config.ratio)
        if len(matches) < self.config.min_inliers:
            return None
        here = features.xy[matches[:, 0]].astype(np.float64)
        there = seen.xy[matches[:, 1]].astype(np.float64)
        relative = estimate_relative_pose(
            there, here, image.camera, query.camera, self.config.max_error_px, self.config.seed
        )
        if relative is None:
            return None
        here_rays, here_valid = query.camera.unproject(torch.from_numpy(here))
        there_rays, there_valid = image.camera.unproject(torch.from_numpy(there))
        kept = torch.from_numpy(relative.inliers) & here_valid & there_valid
        if int(kept.sum()) < self.config.min_inliers:
            return None
        return Matches(image.pose, here_rays[kept], there_rays[kept]), relative.b_from_a

    def _why_not(self, rays: Rays, tried: int) -> str:
        if len(rays) < 2:
            return f"{len(rays)} of {tried} references match the query, 2 are needed"
        if rays.widest_deg() < self.config.least_angle_deg:
            return f"the rays of {len(rays)} references are parallel to {rays.widest_deg():.1f}°"
        return f"no two of {len(rays)} references agree where the query is"


def _rays(found: Sequence[tuple[Matches, Pose]]) -> Rays:
    """Where each photograph stands, and what it says of the query."""
    origins, directions, rotations = (
        np.zeros((len(found), 3)),
        np.zeros((len(found), 3)),
        np.zeros((len(found), 3, 3)),
    )
    for k, (matches, query_from_reference) in enumerate(found):
        rotation = matches.reference.rotation
        origins[k] = matches.reference.centre()
        directions[k] = rotation.T @ query_from_reference.centre()
        rotations[k] = query_from_reference.rotation @ rotation
    return Rays(origins, directions, rotations)
