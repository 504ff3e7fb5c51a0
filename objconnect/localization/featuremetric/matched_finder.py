"""Candidate poses from another method, such as one that matches learned keypoints.

Learned matchers recognize a place where the coarse search does not; alignment then gives a more
exact pose than their matches do.
"""

from __future__ import annotations

from dataclasses import replace

from objconnect.localization.cache.map_cache import MapCache
from objconnect.localization.coarse.search import Candidate
from objconnect.localization.featuremetric.priors import is_near_prior
from objconnect.scene.errors import InputError
from objconnect.scene.localizer import Localizer, MapPart, PoseSource, PreparesParts, Query, Status


class MatchedFinder:
    """Finds candidates of a query by another method.

    Args:
        localizer: the other method, not yet prepared.
    """

    def __init__(self, localizer: Localizer) -> None:
        self._localizer = localizer

    @property
    def weights_sha256(self) -> str | None:
        """Return the digest of the other method's weights; None if it has none."""
        return self._localizer.weights_sha256

    def prepare(self, map_cache: MapCache) -> None:
        """Prepare the other method for a map.

        Raises:
            InputError: its weights or an extra are missing, or a photograph is damaged.
        """
        try:
            self._localizer.prepare(map_cache.sparse_map, map_cache.images, map_cache.folder)
        except InputError as error:
            raise InputError(f"search.matcher {self._localizer.name}: {error}") from error

    def prepare_part(self, map_cache: MapCache, part: MapPart) -> None:
        """Fill the cache for a part of the photographs, if the other method supports that."""
        if isinstance(self._localizer, PreparesParts):
            self._localizer.prepare_part(
                map_cache.sparse_map, map_cache.images, map_cache.folder, part
            )

    def find(self, query: Query) -> list[Candidate]:
        """Return the other method's pose of a query; an empty list if there is none near the prior.

        A fallback is no candidate, because it is the prior or a reference image.
        """
        found = self._localizer.localize(replace(query, tracked=False))
        pose = found.cam_from_world
        if found.status is not Status.OK or pose is None or not is_near_prior(query.prior, pose):
            return []
        return [Candidate(pose, float(found.inliers), PoseSource.MATCHES)]
