"""Where a query may be, by its objects: starts of the alignment where no prior gives them."""

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

# Headings tried over the full turn: within half a step, neighbours look alike.
_HEADINGS: Final = 24
# Angles between the camera's axis and the plumb line, tried where gravity is not known, one after
# the other.
_TILTS_DEG: Final = (0.0, 15.0, 30.0, 45.0, 60.0)
# The other tilts are not tried where the best place of the first has so many times the score of the
# second.
_CLEAR_RATIO: Final = 2.0


class ObjectSearchOptions(Config):
    """Options of starts from objects."""

    candidates: int = Field(
        12, ge=1, description="Places to return at most, before those of the place search."
    )
    most_landmarks: int = Field(
        5000,
        ge=0,
        description="In a map with more of them the place search is asked first. Its time grows "
        "less with the map, and more things look alike.",
    )


class ObjectSearch:
    """Finds places of a map by the objects of a query.

    Args:
        network: with a detector and a graph over objects.
        extract: of its feature maps.
        options: of the search.

    Attributes:
        is_first: once prepared, whether the map is small enough to ask objects before the place
            search.
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

    def watcher(self, source: ReferenceSource) -> MapObjects | None:
        """Return what finds objects in the feature maps of a map's photographs, or of a part.

        It is None where the cache holds the objects.
        """
        self._watched = self._find.watcher(source)
        return self._watched

    def prepare(self, source: ReferenceSource) -> None:
        """Find the objects of a map, or take those that the watcher found or the cache holds.

        Args:
            source: what references of the map are computed from.

        Raises:
            InputError: a photograph is broken or changed meanwhile.
        """
        landmarks = self._find.load_landmarks(source, self._watched)
        self._watched, sparse_map = None, source.kept.sparse_map
        ground = map_ground(sparse_map)
        # Photographs of a street look over the ground, and show no object from above.
        self._connect = None
        if len(landmarks):
            self._connect = Connector(self._graph, landmarks, ground, self._options.candidates)
        self._heights = [sparse_map.height_above(centre) for centre in sparse_map.centres]
        self.is_first = len(landmarks) <= self._options.most_landmarks

    def find(self, query: Query) -> list[Candidate]:
        """Return places where the query may be, best first; none in a map without objects."""
        if self._connect is None:
            return []
        found = self._find(query.image, query.camera)
        base, *rest = headings_around(query.prior, self._heights)
        if query.prior is not None and query.prior.cam_from_world_rotation is not None:
            return self._connect(found, query.camera, base, *rest)
        connect = self._connect
        places: list[Candidate] = []
        with progress_within("objects, tilts of camera", len(_TILTS_DEG)) as advance:
            for done, degrees in enumerate(_TILTS_DEG, 1):
                # A camera that is tilted looks ahead: the ground is at the bottom of its picture.
                up = so3_exp(torch.tensor([-math.radians(degrees), 0.0, 0.0], dtype=torch.float64))
                places += connect(found, query.camera, up @ base, *rest)
                advance(done)
                if done == 1 and (not places or _is_clear(places)):
                    break
        return sorted(places, key=lambda place: -place.score)[: self._options.candidates]


def _is_clear(places: Sequence[Candidate]) -> bool:
    """Return whether the first of some places stands out."""
    return len(places) == 1 or places[0].score > _CLEAR_RATIO * places[1].score


def headings_around(
    prior: Prior | None, heights: Sequence[float], headings: int = _HEADINGS
) -> tuple[Tensor, list[float], list[float]]:
    """Return what may be: the attitude at a heading of 0, headings (rad) and heights (m).

    Args:
        prior: what is known; without an attitude the camera is taken to look straight down.
        heights: of the map's photographs above the ground.
        headings: tried over the full turn.
    """
    base, turns = possible_headings(prior, headings)
    return base, turns, [part * float(np.median(heights)) for part in ALTITUDES]
