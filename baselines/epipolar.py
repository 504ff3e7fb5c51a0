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
from objconnect.localization.matching.retrieval import OnDemand, References
from objconnect.localization.matching.sift import Sift
from objconnect.scene.colmap.relative_pose import estimate_relative_pose
from objconnect.scene.config import Config
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.rays import Rays
from objconnect.scene.geometry.sampson import Matches, refine
from objconnect.scene.localizer import By, Estimate, Query, Status, Stopwatch, query_error
from objconnect.scene.maps.features import Features
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.storage.lru_cache import LruCache, room

# Least number of inliers of a reference image: a relative pose needs five matches, and fifteen more
# that agree are no coincidence.
_MIN_INLIERS: Final = 20
# Largest difference between reference images in the query's attitude and direction.
_AGREE_DEG: Final = 5.0
# Least angle between two rays that determine the position.
_LEAST_ANGLE_DEG: Final = 5.0


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
class _Seen:
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
        with open_cache(sparse_map, images, cache) as kept:
            features = map_features(kept, self._sift)

        def extract(name: str) -> _Seen:
            keypoints = features[name]
            return _Seen(keypoints.xy, unit(keypoints.descriptors))

        def describe(row: int) -> NDArray[np.float32]:
            return unit(features[sparse_map.names[row]].descriptors).numpy()

        self._seen = LruCache(extract, room(self.config.memory_mb))
        count = len(sparse_map.names)
        self._references = References.build(sparse_map, OnDemand(describe, count))

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
            related = [each for each in attempts if each is not None]
        with clock.stage("pose"):
            rays = _rays(related)
            agreeing = rays.consensus(_AGREE_DEG, _LEAST_ANGLE_DEG)
            if not len(agreeing):
                reason = self._why_not(rays, len(references))
                return Estimate(Status.FAILED, seconds=clock.seconds, reason=reason)
            chosen = rays[agreeing]
            rotation = chosen.attitude()
            start = Pose(torch.from_numpy(rotation), torch.from_numpy(-rotation @ chosen.meet()))
            used = [related[row][0] for row in agreeing]
            focal = float(np.mean(query.camera.focal))
            refined = refine(start, used, focal)
        return Estimate(
            Status.OK,
            refined.pose,
            refined.covariance,
            inliers=sum(len(matches.query_rays) for matches in used),
            iterations=refined.iterations,
            seconds=clock.seconds,
            by=By.MATCHES,
        )

    def _relate(
        self, query: Query, features: Features, unit: Tensor, image: MapImage
    ) -> tuple[Matches, Pose] | None:
        """Return the matches and ``query_from_reference`` of an image; None if too few agree."""
        seen = self._seen(image.name)
        matches = self._sift.match(unit, seen.unit, self.config.ratio)
        if len(matches) < _MIN_INLIERS:
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
        if int(kept.sum()) < _MIN_INLIERS:
            return None
        return Matches(image.pose, here_rays[kept], there_rays[kept]), relative.b_from_a

    def _why_not(self, rays: Rays, tried: int) -> str:
        if len(rays) < 2:
            return f"{len(rays)} of {tried} references match the query, 2 are needed"
        if rays.widest_deg() < _LEAST_ANGLE_DEG:
            return f"the rays of {len(rays)} references are parallel to {rays.widest_deg():.1f}°"
        return f"no two of {len(rays)} references agree where the query is"


def _rays(related: Sequence[tuple[Matches, Pose]]) -> Rays:
    """Return the rays from reference images to the query, and its attitude from each."""
    origins, directions, rotations = (
        np.zeros((len(related), 3)),
        np.zeros((len(related), 3)),
        np.zeros((len(related), 3, 3)),
    )
    for k, (matches, query_from_reference) in enumerate(related):
        rotation = matches.reference.rotation
        origins[k] = matches.reference.centre()
        directions[k] = rotation.T @ query_from_reference.centre()
        rotations[k] = query_from_reference.rotation @ rotation
    return Rays(origins, directions, rotations)
