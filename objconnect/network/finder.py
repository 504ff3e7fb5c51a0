"""Candidate poses of a query from its objects, as starts of the alignment without a prior."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from objconnect.localization.coarse.headings import ALTITUDES, possible_headings
from objconnect.localization.coarse.search import Candidate
from objconnect.localization.featuremetric.maps import MapExtractor
from objconnect.localization.featuremetric.references import ReferenceSource
from objconnect.network.network import ObjConnectNet
from objconnect.network.object_map import MapObjects, ObjectFinder, map_ground
from objconnect.network.object_matching import Connector
from objconnect.scene.config import Config
from objconnect.scene.geometry.pose import so3_exp
from objconnect.scene.localizer import Prior, Query
from objconnect.scene.runtime.progress import progress_within

# Number of headings over the full turn; within half a step the graph's vectors change little.
_HEADINGS: Final = 24
# Tilts of the camera to try, one after the other, if gravity is unknown.
_TILTS_DEG: Final = (0.0, 15.0, 30.0, 45.0, 60.0)
# Ratio of the best to the second-best score at the first tilt from which no other tilt is tried.
_CLEAR_RATIO: Final = 2.0


class ObjectSearchOptions(Config):
    """Options of the search by objects."""

    candidates: int = Field(12, ge=1, description="Maximum number of candidates.")
    most_landmarks: int = Field(
        5000,
        ge=0,
        description="Number of landmarks of a map above which the coarse search comes before the "
        "search by objects. Its time grows less with the map, and more objects look alike.",
    )


class ObjectSearch:
    """Finds candidate poses in a map by the objects of a query.

    Args:
        network: network with a detector and a graph over objects.
        extract: computes its feature maps.
        options: options of the search.

    Attributes:
        is_first: once prepared, whether the map is small enough for this search to come before the
            coarse search.
    """

    def __init__(
        self, network: ObjConnectNet, extract: MapExtractor, options: ObjectSearchOptions
    ) -> None:
        assert network.detector is not None and network.constellation is not None
        self._graph, self._options = network.constellation, options
        self._find = ObjectFinder(extract, network.detector)
        self._connect: Connector | None = None
        self._watched: MapObjects | None = None
        self.is_first = True

    def observer(self, source: ReferenceSource) -> MapObjects | None:
        """Return an observer that finds objects in the feature maps of a map's photographs.

        It is None if the cache holds the objects.
        """
        self._watched = self._find.observer(source)
        return self._watched

    def prepare(self, source: ReferenceSource) -> None:
        """Find the objects of a map unless the observer or the cache has them.

        Raises:
            InputError: a photograph is broken or changed meanwhile.
        """
        landmarks = self._find.load_landmarks(source, self._watched)
        self._watched, sparse_map = None, source.kept.sparse_map
        ground = map_ground(sparse_map)
        # A map of street-level photographs has no objects seen from above.
        self._connect = None
        if len(landmarks):
            self._connect = Connector(self._graph, landmarks, ground, self._options.candidates)
        self._heights = [sparse_map.height_above(centre) for centre in sparse_map.centres]
        self.is_first = len(landmarks) <= self._options.most_landmarks

    def find(self, query: Query) -> list[Candidate]:
        """Return candidates, best first; none in a map without objects."""
        if self._connect is None:
            return []
        found = self._find(query.image, query.camera)
        base, *rest = headings_around(query.prior, self._heights)
        if query.prior is not None and query.prior.cam_from_world_rotation is not None:
            return self._connect(found, query.camera, base, *rest)
        connect = self._connect
        candidates: list[Candidate] = []
        with progress_within("objects, tilts of camera", len(_TILTS_DEG)) as advance:
            for done, degrees in enumerate(_TILTS_DEG, 1):
                # A tilted camera looks ahead: the ground is at the bottom of its picture.
                up = so3_exp(torch.tensor([-math.radians(degrees), 0.0, 0.0], dtype=torch.float64))
                candidates += connect(found, query.camera, up @ base, *rest)
                advance(done)
                if done == 1 and (not candidates or _is_clear(candidates)):
                    break
        return sorted(candidates, key=lambda each: -each.score)[: self._options.candidates]


def _is_clear(candidates: Sequence[Candidate]) -> bool:
    """Return whether the first candidate has a clearly higher score than the second."""
    return len(candidates) == 1 or candidates[0].score > _CLEAR_RATIO * candidates[1].score


def headings_around(
    prior: Prior | None, heights: Sequence[float], headings: int = _HEADINGS
) -> tuple[Tensor, list[float], list[float]]:
    """Return the attitude at a heading of 0, and the headings (rad) and heights (m) to try.

    Args:
        prior: prior of the query; without an attitude the camera is assumed to look straight down.
        heights: heights of the map's photographs above the ground, metres.
        headings: number of headings over the full turn.
    """
    base, turns = possible_headings(prior, headings)
    return base, turns, [part * float(np.median(heights)) for part in ALTITUDES]
