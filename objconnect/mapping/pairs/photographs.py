"""Render photographs as a drone's camera would take them, from an orthophoto at exact poses."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Final, NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.ingestion.virtual.flight import view_pose
from objconnect.ingestion.virtual.survey import MAX_DEPTH_ALTITUDES, Survey
from objconnect.mapping.pairs.options import PairQueryOptions
from objconnect.mapping.pairs.registration import Area
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.runtime.progress import progress_bar

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

# Range of the ratio of a query's pixel on the ground to the orthophoto's, if no height is given.
_PIXEL_RATIOS: Final = (0.8, 1.6)
# Minimum share of a query that each survey (orthophoto on a surface model) fills, and side (px) of
# the previews that measure it.
_MIN_FILLED: Final = 0.99
_TEST_SIDE: Final = 32
# Maximum number of poses that are drawn per query.
_MAX_TRIES: Final = 200
# A pose is rendered only if the corners of its view, on level ground, lie at most this share of the
# height outside the shared area.
_CORNER_MARGIN: Final = 0.05
# Minimum fall of a corner's ray per metre along the optical axis; flatter rays are clamped to it.
_MIN_FALL: Final = 0.05


class Photograph(NamedTuple):
    """A query, with its exact pose.

    Attributes:
        rgb: (H, W, 3) uint8.
        cam_from_world: exact pose.
        height_m: height of the camera above the ground, metres.
    """

    rgb: Picture
    cam_from_world: Pose
    height_m: float


def query_camera(options: PairQueryOptions) -> Camera:
    """Return the camera of all queries."""
    half = options.size / 2
    focal = half / math.tan(math.radians(options.fov_deg) / 2)
    return Camera("PINHOLE", options.size, options.size, (focal, focal, half, half))


def height_range(options: PairQueryOptions, pixel_m: float) -> tuple[float, float]:
    """Return the lowest and highest height of queries above the ground, metres.

    Args:
        options: the range of heights, or else the camera that determines it.
        pixel_m: pixel of the orthophoto on the ground, metres.
    """
    if options.height_m is not None:
        return options.height_m
    low, high = (scale * pixel_m * query_camera(options).focal[0] for scale in _PIXEL_RATIOS)
    return low, high


def take_photographs(
    query_survey: Survey, map_survey: Survey, area: Area, options: PairQueryOptions
) -> Iterator[Photograph]:
    """Yield the queries: views of one survey from poses at which both surveys fill the picture.

    Args:
        query_survey: survey of the date of the queries.
        map_survey: survey of the date of the map, in the same world coordinates.
        area: ground that both surveys cover.
        options: camera, poses and image quality of the queries.

    Raises:
        InputError: too few of the drawn poses see enough of both surveys.
    """
    camera = query_camera(options)
    test_camera = camera.resize(_TEST_SIDE, _TEST_SIDE)
    heights = height_range(options, max(query_survey.surface.colours.grid.ground_pixel))
    rng = np.random.default_rng(options.seed)
    drawn = 0
    with progress_bar("queries", options.queries) as advance:
        for _ in range(_MAX_TRIES * options.queries):
            height = float(rng.uniform(*heights))
            centre = replace(map_survey, altitude=height).above_ground(rng.uniform(*area))
            pose = _draw_pose(centre, options.tilt_deg, rng)
            if not _is_view_inside(test_camera, pose, height, area):
                continue
            views = (
                each.surface.render(test_camera, pose, MAX_DEPTH_ALTITUDES * height)
                for each in (map_survey, query_survey)
            )
            if min(view.coverage for view in views) < _MIN_FILLED:
                continue
            rgb = query_survey.surface.render(camera, pose, MAX_DEPTH_ALTITUDES * height).rgb
            yield Photograph(add_camera_effects(rgb, options, rng), Pose.from_matrix(pose), height)
            drawn += 1
            advance(drawn)
            if drawn == options.queries:
                return
    raise InputError(
        f"only {drawn} of {options.queries} queries from {heights[0]:.0f} to {heights[1]:.0f} m "
        "above the ground lie within both orthophotos: choose a smaller height_m, or larger files"
    )


def _is_view_inside(camera: Camera, pose: Array, height: float, area: Area) -> bool:
    """Return whether level ground in the corners of a view is inside an area, or close to it."""
    across, down = (0.0, camera.width), (0.0, camera.height)
    corners = torch.tensor([(x, y) for x in across for y in down], dtype=torch.float64)
    rays = camera.unproject(corners)[0].numpy() @ pose[:3, :3]
    centre = -pose[:3, :3].T @ pose[:3, 3]
    ground = centre[:2] + rays[:, :2] * (height / np.maximum(-rays[:, 2:], _MIN_FALL))
    margin = _CORNER_MARGIN * height
    return bool((ground > area.low - margin).all() and (ground < area.high + margin).all())


def _draw_pose(centre: Array, tilt_deg: float, rng: np.random.Generator) -> Array:
    """Draw a pose (4, 4) at a centre (3,), with any heading and a tilt in any direction."""
    azimuth, roll = rng.uniform(0, 360), rng.uniform(0, math.tau)
    pose = view_pose(centre, azimuth, rng.uniform(0, tilt_deg))
    cosine, sine = math.cos(roll), math.sin(roll)
    axis_rotation = np.eye(4)
    axis_rotation[:2, :2] = [[cosine, -sine], [sine, cosine]]
    return np.asarray(axis_rotation @ pose)


def add_camera_effects(
    rgb: Picture, options: PairQueryOptions, rng: np.random.Generator
) -> Picture:
    """Return a render (H, W, 3) with the blur, vignetting and noise of a drone's picture."""
    picture = rgb.astype(np.float32)
    if options.blur_px > 0:
        picture = cv2.GaussianBlur(picture, (0, 0), options.blur_px)
    axes = [(np.arange(n) + 0.5) * (2 / n) - 1 for n in picture.shape[:2]]
    from_middle = (axes[0][:, None] ** 2 + axes[1] ** 2) / 2
    picture = picture * (1 - options.vignetting * from_middle)[..., None]
    picture = picture + rng.normal(0, options.noise, picture.shape)
    return np.asarray(np.rint(np.clip(picture, 0, 255)), np.uint8)
