"""Candidate poses of a query by its objects, from which alignment starts without a full prior."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from pydantic import Field
from torch import Tensor

from objconnect.localization.coarse.headings import (
    TILTS_DEG,
    TiltOptions,
    has_attitude,
    possible_headings,
    tilt_rotations,
)
from objconnect.localization.coarse.search import Candidate
from objconnect.localization.featuremetric.maps import MapExtractor
from objconnect.localization.featuremetric.priors import region
from objconnect.localization.featuremetric.references import ReferenceSource
from objconnect.network.network import ObjConnectNet
from objconnect.network.object_map import MapObjects, ObjectFinder, map_ground
from objconnect.network.object_matching import ObjectMatcher
from objconnect.network.object_pairs import Bounds
from objconnect.scene.localizer import Prior, Query

ALTITUDE_RATIOS: Final = (0.5, 0.6, 0.72, 0.87, 1.04, 1.25, 1.5)
"""Heights above ground to try where the altitude is unknown, relative to the height of the map's
photographs. Each is a fifth larger than the one before."""
# Number of evenly spaced headings that are tried if the heading is unknown. Poses with headings
# near them are allowed.
_HEADINGS: Final = 24


class ObjectSearchOptions(TiltOptions):
    """Options of the search by objects."""

    candidates: int = Field(4, ge=1, description="Maximum number of candidates.")
    most_landmarks: int = Field(
        5000,
        ge=0,
        description="Number of objects of a map above which the coarse search comes before the "
        "search by objects: the time of the coarse search grows less with the map, and in a large "
        "map more objects look alike.",
    )


class ObjectSearch:
    """Finds candidate poses in a map by the objects of a query.

    Args:
        network: network with a detector and a graph over objects.
        extract: computes its feature maps.
        options: options of the search.

    Attributes:
        is_first: whether this search comes before the coarse search, because the map has few
            objects. It is valid once ``prepare`` has run.
    """

    def __init__(
        self, network: ObjConnectNet, extract: MapExtractor, options: ObjectSearchOptions
    ) -> None:
        assert network.detector is not None and network.constellation is not None
        self._graph, self._options = network.constellation, options
        self._finder = ObjectFinder(extract, network.detector)
        self._matcher: ObjectMatcher | None = None
        self._observer: MapObjects | None = None
        self.is_first = True

    def observer(self, source: ReferenceSource) -> MapObjects | None:
        """Return an observer that finds objects in the feature maps of a map's photographs.

        It is None if the cache holds the objects.
        """
        self._observer = self._finder.observer(source)
        return self._observer

    def prepare(self, source: ReferenceSource) -> None:
        """Find the objects of a map unless the observer or the cache has them.

        Raises:
            InputError: a photograph is broken or changed meanwhile.
        """
        landmarks = self._finder.load_landmarks(source, self._observer)
        self._observer, sparse_map = None, source.map_cache.sparse_map
        ground = map_ground(sparse_map)
        # A map of street-level photographs has no objects seen from above.
        self._matcher = None
        if len(landmarks):
            self._matcher = ObjectMatcher(self._graph, landmarks, ground, self._options.candidates)
        self._heights = [sparse_map.height_above(centre) for centre in sparse_map.centres]
        self.is_first = len(landmarks) <= self._options.most_landmarks

    def find(self, query: Query) -> list[Candidate]:
        """Return candidates, best first; none in a map without objects."""
        if self._matcher is None:
            return []
        found = self._finder(query.image, query.camera)
        tried = allowed_poses(query.prior, self._heights, self._options.tilts_deg)
        return self._matcher(found, query.camera, *tried)


def allowed_poses(
    prior: Prior | None,
    heights: Sequence[float],
    tilts_deg: Sequence[float] = TILTS_DEG,
    headings: int = _HEADINGS,
) -> tuple[list[Tensor], Bounds]:
    """Return the attitudes to try, and the bounds of the poses to allow.

    The bounds are angles from the headings of the attitudes, heights above ground, and a region.

    Args:
        prior: prior of the query.
        heights: heights of the map's photographs above the ground, metres.
        tilts_deg: tilts of the camera to try if the prior has no attitude, degrees.
        headings: number of headings on the full circle.
    """
    base, turns = possible_headings(prior, headings)
    bounds = Bounds(
        turns, [part * float(np.median(heights)) for part in ALTITUDE_RATIOS], region(prior)
    )
    if has_attitude(prior):
        return [base], bounds
    return [tilt @ base for tilt in tilt_rotations(tilts_deg)], bounds
