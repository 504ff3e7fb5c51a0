"""The coarse search of a map for the position, heading and altitude that a prior leaves unknown."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from pydantic import Field
from torch import Tensor

from objconnect.localization.cache.map_cache import EarlierRows, MapCache
from objconnect.localization.cache.store import Rows
from objconnect.localization.coarse.grid import GroundGrid, ground_grid
from objconnect.localization.coarse.headings import (
    NO_TILT,
    TiltOptions,
    has_attitude,
    possible_headings,
    tilt_rotations,
)
from objconnect.localization.coarse.mosaic import Mosaic, empty_mosaic, make_mosaic
from objconnect.localization.coarse.search import UP, Candidate, Hypotheses, MosaicSearch
from objconnect.localization.featuremetric.maps import FeatureMap, MapExtractor
from objconnect.localization.resolution import (
    map_resolution,
    metres_per_pixel,
    observed_xyz,
    scale_to,
)
from objconnect.scene.geometry.pose import Pose, so3_exp
from objconnect.scene.geometry.views import WarpedImage, level_rotation, map_angle, tilt
from objconnect.scene.localizer import Prior, Query
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.images import read_rgb

_FORMAT: Final = 3
# Lower bound of the cosine of the tilt. The distance to the ground along the optical axis is the
# height divided by the cosine, and would be infinite for a camera that looks at the horizon.
_MIN_TILT_COSINE: Final = 0.3
# An altitude is not searched if the sigma of the prior's altitude is less than this share of the
# height above ground.
_KNOWN_ALTITUDE_SHARE: Final = 0.1
# Number of headings, over the full circle, at which the network runs on a query.
_HEADINGS: Final = 12
# Number of headings that are tried with the features of one run of the network. Features tolerate a
# few degrees.
_TURNS: Final = 5
# Side of a cell of the mosaic in pixels of a resized photograph: the coarsest stride of the
# network.
_CELL_PX: Final = 16
# Number of principal components to which features are reduced. It bounds time and memory.
_CHANNELS: Final = 32
ALTITUDE_RATIOS: Final = (0.5, 0.6, 0.72, 0.87, 1.04, 1.25, 1.5, 1.8)
"""Heights above ground to try where the altitude is unknown, relative to the height of the map's
photographs. Each is a fifth larger than the one before."""
LONGER_SIDE_PX: Final = 256
"""Photographs are resized to about this longer side (px), so that the features of
a cell describe a large patch of ground."""
# A query with a larger tilt is warped to this tilt (radians), because nearly all photographs of a
# map look down.
_MAX_TILT: Final = math.radians(45)
# Radius of the search around an uncertain position in standard deviations; two cells of the mosaic
# are added.
_REACH_SIGMAS: Final = 3.0


class CoarseSearchOptions(TiltOptions):
    """Options of the coarse search."""

    candidates: int = Field(
        6,
        ge=0,
        description="Maximum number of candidates at the known attitude, or at the first of "
        "``tilts_deg``, and again at all other tilts together; 0 for no coarse search.",
    )


class CoarseSearch:
    """Finds candidate poses of a query in a map with the coarsest features of a network."""

    def __init__(self, extract: MapExtractor, options: CoarseSearchOptions) -> None:
        self._extract = extract
        self._options = options

    def prepare(self, map_cache: MapCache, key: str) -> None:
        """Make the mosaic of a map, or read it from the cache.

        Args:
            map_cache: the map, its photographs and the cache.
            key: identifies the network's weights and its options, for the cache.

        Raises:
            InputError: a photograph is broken or changed meanwhile.
        """
        sparse_map = map_cache.sparse_map
        map_images = [sparse_map.images[name] for name in sparse_map.names]
        sharpest = map_resolution(sparse_map, self._extract.largest_scale)
        sides = [
            max(image.camera.width, image.camera.height) * self._extract.largest_scale(image.camera)
            for image in map_images
        ]
        self._resolution = sharpest * max(1.0, float(np.median(sides)) / LONGER_SIDE_PX)
        heights = [sparse_map.height_above(image.pose.centre().numpy()) for image in map_images]
        self._height = float(np.median(heights))

        def rows(_: EarlierRows) -> Rows:
            yield "", self._make_mosaic(sparse_map, map_cache.images).arrays()

        store = map_cache.store(
            "mosaic", _FORMAT, key, _CELL_PX, _CHANNELS, LONGER_SIDE_PX, rows=rows
        )
        self._mosaic = store.make(0, Mosaic.ARRAYS, Mosaic.of).to(self._extract.device)
        self._search = MosaicSearch(self._mosaic)

    def _make_mosaic(self, sparse_map: SparseMap, images: Path) -> Mosaic:
        def extract(image: MapImage) -> tuple[WarpedImage, FeatureMap]:
            resolution = metres_per_pixel(image.pose, image.camera, observed_xyz(image, sparse_map))
            largest = self._extract.largest_scale(image.camera)
            scale = scale_to(self._resolution, resolution, largest)
            angle = map_angle(image.cam_from_world[:3, :3])
            rgb = read_rgb(images / image.name, image.camera)
            view, levels = self._extract(rgb, image.camera, angle, scale, 1)
            return view, levels[0]

        if not math.isfinite(self._resolution):
            return empty_mosaic(ground_grid(sparse_map.xyz[:1], 1.0))
        grid = ground_grid(sparse_map.xyz, _CELL_PX * self._resolution)
        with progress_bar("mosaic of the map", len(sparse_map.names)) as advance:
            return make_mosaic(sparse_map, grid, _CHANNELS, extract, advance)

    def find(self, query: Query) -> Iterator[list[Candidate]]:
        """Yield the candidates at the known attitude or the first tilt, then those at other tilts.

        Each list has its best candidate first. No list is yielded if no photograph of the map looks
        down, or if the query has a single colour. All tilts use the same features of the query.
        """
        if self._mosaic.is_empty or (query.image == query.image[0, 0]).all():
            return
        first, *others = tilt_rotations(self._options.tilts_deg)
        tried = hypotheses(query.prior, self._mosaic.grid, self._height, first)
        views = self._search.extract_views(partial(self._extract_for, query), tried)
        yield self._search(views, tried, self._options.candidates)
        if others and not has_attitude(query.prior):
            yield self._search(views, replace(tried, tilts=others), self._options.candidates)

    def _extract_for(self, query: Query, pose: Pose) -> tuple[WarpedImage, FeatureMap]:
        """Warp a query for a pose, and compute its features of the coarsest level."""
        rotation, view_from_camera = pose.rotation.numpy(), None
        if tilt(rotation) > _MAX_TILT:
            view_from_camera = level_rotation(rotation, _MAX_TILT) @ rotation.T
        # The optical axis of the view, east-north-up.
        axis = rotation[2] if view_from_camera is None else view_from_camera[2] @ rotation
        cosine = max(_MIN_TILT_COSINE, -float(axis[2]))
        resolution = float(pose.centre()[2]) / cosine / float(np.mean(query.camera.focal))
        scale = scale_to(self._resolution, resolution, self._extract.largest_scale(query.camera))
        angle = map_angle(rotation)
        view, levels = self._extract(query.image, query.camera, angle, scale, 1, view_from_camera)
        return view, levels[0]


def hypotheses(
    prior: Prior | None, grid: GroundGrid, height: float, tilt_rotation: Tensor = NO_TILT
) -> Hypotheses:
    """Return the headings, altitudes, tilts and region to search, given a prior.

    Tilt and roll of the prior are kept. The heading and position are searched around the prior
    within a number of standard deviations, or everywhere if they are unknown. The altitude is the
    prior's if its standard deviation is small; else all ``ALTITUDE_RATIOS`` are searched.

    Args:
        prior: prior of the query.
        grid: grid of the ground.
        height: height of the map's photographs above ground, metres.
        tilt_rotation: (3, 3), tilts the camera if the prior has no attitude.
    """
    step = math.tau / _HEADINGS
    turns = [(k - (_TURNS - 1) / 2) * step / _TURNS for k in range(_TURNS)]
    base, headings = possible_headings(prior, _HEADINGS)
    passes: list[Tensor] = [base @ so3_exp(heading * UP) for heading in headings]
    altitudes = [ratio * height for ratio in ALTITUDE_RATIOS]
    region = None
    if prior is not None and prior.position_sigma is not None:
        east, north, up = (float(each) for each in prior.position)
        if (sigma := prior.horizontal_sigma) is not None:
            region = (east, north, _REACH_SIGMAS * sigma + 2 * grid.cell)
        altitude = up - grid.height_at(east, north)
        if prior.position_sigma[2] < _KNOWN_ALTITUDE_SHARE * altitude:
            altitudes = [altitude]
    tilts = [NO_TILT if has_attitude(prior) else tilt_rotation]
    return Hypotheses(passes, turns, altitudes, region, tilts)
