"""The coarse search of a map: it keeps what a prior gives and searches the rest."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import numpy as np
from pydantic import Field
from torch import Tensor

from objconnect.localization.cache.map_cache import Earlier, MapCache
from objconnect.localization.cache.store import Rows
from objconnect.localization.coarse.grid import GroundGrid, ground_grid
from objconnect.localization.coarse.headings import ALTITUDES, possible_headings
from objconnect.localization.coarse.mosaic import Mosaic, empty_mosaic, make_mosaic
from objconnect.localization.coarse.search import UP, Candidate, Hypotheses, MosaicSearch
from objconnect.localization.featuremetric.maps import FeatureMap, MapExtractor
from objconnect.localization.resolution import (
    map_resolution,
    metres_per_pixel,
    observed_xyz,
    scale_to,
)
from objconnect.scene.config import Config
from objconnect.scene.geometry.pose import Pose, so3_exp
from objconnect.scene.geometry.views import WarpedImage, level_rotation, map_angle, tilt
from objconnect.scene.localizer import Prior, Query
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.images import read_rgb

_FORMAT: Final = 3
# Lower bound of the cosine of the tilt that divides the height by the distance to the ground.
_MIN_TILT_COSINE: Final = 0.3
# An altitude whose sigma is a smaller share of the height above ground is not searched.
_KNOWN_ALTITUDE: Final = 0.1
# Headings at which the network runs on a query, spread over the full turn, and headings tried with
# the features of each: features tolerate a few degrees.
_HEADINGS: Final = 12
_TURNS: Final = 5
# Side of a cell of the mosaic, pixels of a photograph: that of the coarsest cells of features.
_CELL_PX: Final = 16
# Number of principal components of the features, which bounds time and memory.
_CHANNELS: Final = 32
LONGEST: Final = 256
"""Photographs are resized to about this longer side (px), at which large things show."""
# A query that is tilted more is warped to this tilt, as nearly all photographs of a map look down.
_MOST_TILT: Final = math.radians(45)


class CoarseSearchOptions(Config):
    """Options of the coarse search."""

    candidates: int = Field(
        16, ge=0, description="Maximum number of candidates; 0 for no coarse search."
    )
    reach_sigmas: float = Field(
        3.0,
        gt=0,
        description="Radius of the search around an uncertain position in standard deviations; two "
        "cells are added.",
    )


class CoarseSearch:
    """Finds candidate poses of a query in a map with the coarsest features of a network."""

    def __init__(self, extract: MapExtractor, options: CoarseSearchOptions) -> None:
        self._extract = extract
        self._options = options

    def prepare(self, kept: MapCache, key: str) -> None:
        """Make the mosaic of a map, or read it from the cache.

        Raises:
            InputError: a photograph is broken or changed meanwhile.
        """
        sparse_map = kept.sparse_map
        posed = [sparse_map.images[name] for name in sparse_map.names]
        sharpest = map_resolution(sparse_map, self._extract.largest_scale)
        sides = [
            max(image.camera.width, image.camera.height) * self._extract.largest_scale(image.camera)
            for image in posed
        ]
        self._resolution = sharpest * max(1.0, float(np.median(sides)) / LONGEST)
        heights = [sparse_map.height_above(image.pose.centre().numpy()) for image in posed]
        self._height = float(np.median(heights))

        def rows(_: Earlier) -> Rows:
            yield "", self._make(sparse_map, kept.images).arrays()

        store = kept.store("mosaic", _FORMAT, key, _CELL_PX, _CHANNELS, LONGEST, rows=rows)
        self._mosaic = store.make(0, Mosaic.ARRAYS, Mosaic.of).on(self._extract.device)
        self._search = MosaicSearch(self._mosaic)

    def _make(self, sparse_map: SparseMap, images: Path) -> Mosaic:
        def look(image: MapImage) -> tuple[WarpedImage, FeatureMap]:
            own = metres_per_pixel(image.pose, image.camera, observed_xyz(image, sparse_map))
            largest = self._extract.largest_scale(image.camera)
            scale = scale_to(self._resolution, own, largest)
            angle = map_angle(image.cam_from_world[:3, :3])
            rgb = read_rgb(images / image.name, image.camera)
            view, levels = self._extract(rgb, image.camera, angle, scale, 1)
            return view, levels[0]

        if not math.isfinite(self._resolution):
            return empty_mosaic(ground_grid(sparse_map.xyz[:1], 1.0))
        grid = ground_grid(sparse_map.xyz, _CELL_PX * self._resolution)
        with progress_bar("mosaic of the map", len(sparse_map.names)) as advance:
            return make_mosaic(sparse_map, grid, _CHANNELS, look, advance)

    def find(self, query: Query) -> list[Candidate]:
        """Return candidates, best first; none if no photograph of the map looks down, or if the
        query has a single colour."""
        if self._mosaic.is_empty or (query.image == query.image[0, 0]).all():
            return []

        def look(pose: Pose) -> tuple[WarpedImage, FeatureMap]:
            rotation, turn = pose.rotation.numpy(), None
            if tilt(rotation) > _MOST_TILT:
                turn = level_rotation(rotation, _MOST_TILT) @ rotation.T
            axis = rotation[2] if turn is None else turn[2] @ rotation
            down = max(_MIN_TILT_COSINE, -float(axis[2]))
            own = float(pose.centre()[2]) / down / float(np.mean(query.camera.focal))
            scale = scale_to(self._resolution, own, self._extract.largest_scale(query.camera))
            angle = map_angle(rotation)
            view, levels = self._extract(query.image, query.camera, angle, scale, 1, turn)
            return view, levels[0]

        tried = hypotheses(query.prior, self._options, self._mosaic.grid, self._height)
        return self._search(look, tried, self._options.candidates)


def hypotheses(
    prior: Prior | None, options: CoarseSearchOptions, grid: GroundGrid, height: float
) -> Hypotheses:
    """Return the headings, altitudes and region to search for a prior.

    Tilt and roll of the prior are kept. Its heading, altitude and position are searched as far as
    their sigmas reach.

    Args:
        prior: prior of the query.
        options: options of the search.
        grid: grid of the ground.
        height: height of the map's photographs above ground, metres.
    """
    step = math.tau / _HEADINGS
    turns = [(k - (_TURNS - 1) / 2) * step / _TURNS for k in range(_TURNS)]
    base, headings = possible_headings(prior, _HEADINGS)
    passes: list[Tensor] = [base @ so3_exp(heading * UP) for heading in headings]
    altitudes = [part * height for part in ALTITUDES]
    within = None
    if prior is not None and prior.position_sigma is not None:
        east, north_, up = (float(each) for each in prior.position)
        if (sigma := prior.horizontal_sigma) is not None:
            within = (east, north_, options.reach_sigmas * sigma + 2 * grid.cell)
        above = up - grid.height_at(east, north_)
        if prior.position_sigma[2] < _KNOWN_ALTITUDE * above:
            altitudes = [above]
    return Hypotheses(passes, turns, altitudes, within)
