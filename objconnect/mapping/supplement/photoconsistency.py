"""Photoconsistency of a point: colour differences between photographs at several heights.

Photographs agree on the colours at the height of the surface. Most pixels around a thin object show
the ground, so an unweighted window would measure the ground. Each pixel is therefore weighted by
the similarity of its colour to that of the point (Yoon and Kweon, "Adaptive support-weight approach
for correspondence search", PAMI 2006).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.mapping.supplement.blobs import Blobs, to_lab
from objconnect.mapping.supplement.ground_plane import Ground
from objconnect.mapping.supplement.tracks import Tracks, project
from objconnect.scene.maps.sparse_map import MapImage
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.lru_cache import LruCache

HEIGHTS: Final = np.arange(-0.45, 3.5, 0.15)
"""Heights above the ground that are compared (m). The classifier has a feature for each."""

# Mask of the ``HEIGHTS`` that are at the ground.
_IS_GROUND: Final = np.abs(HEIGHTS) < 0.16
# Cost that replaces an unknown one. The classifier was trained with it.
_UNKNOWN: Final = 15.0
# Radius (px) of the compared window.
_RADIUS_PX: Final = 2
# Weights of pixels fall by a factor of e over this squared distance (px^2), and over this
# difference from the colour of the centre (CIE L*a*b*).
_DISTANCE_SCALE: Final = 6.0
_COLOUR_SCALE: Final = 8.0
# Upper bound of the colour difference of a pixel, summed over L*, a* and b*.
_MAX_DIFFERENCE: Final = 15.0
# Blur (px) of the photographs, because windows are sampled between pixels.
_BLUR_PX: Final = 0.5
# Capacity of the cache, in photographs of the largest size.
_CACHE_PHOTOGRAPHS: Final = 16
# Maximum number of rows per call of OpenCV's remap.
_ROWS: Final = 30000


@dataclass(frozen=True)
class _Windows:
    """Windows of one photograph around N points.

    Attributes:
        colours: colours (N, P, 3) of the P pixels, CIE L*a*b*.
        weights: weights (N, P) of the pixels, which sum to one.
        xyz: points (N, H, P, 3) on the pixels' rays at each height, world metres.
    """

    colours: NDArray[np.float32]
    weights: NDArray[np.float64]
    xyz: NDArray[np.float64]


def compute_costs(
    images: Sequence[MapImage],
    folder: Path,
    blobs: Sequence[Blobs],
    ground: Ground,
    tracks: Tracks,
) -> NDArray[np.float64]:
    """Return the mean colour difference around points at each of ``HEIGHTS``, (T, H).

    The window in the horizontally nearest photograph is compared with all other photographs that
    show the point. The result is NaN where no other photograph shows it.

    Args:
        images: photographs of the map.
        folder: folder of their files.
        blobs: blobs of each photograph.
        ground: the ground below the points.
        tracks: tracks of the points.

    Raises:
        InputError: a photograph is missing or damaged.
    """

    def read(view: int) -> NDArray[np.float32]:
        image = images[view]
        lab = to_lab(read_rgb(folder / image.name, image.camera))
        return np.asarray(cv2.GaussianBlur(lab, (0, 0), _BLUR_PX), np.float32)

    largest = max((image.camera.width * image.camera.height for image in images), default=0)
    read_photograph = LruCache(
        read, _CACHE_PHOTOGRAPHS * 3 * np.dtype(np.float32).itemsize * largest
    )
    above = tracks.xyz[:, 2] - ground.height_at(tracks.xyz[:, :2])
    nearest, row = _find_nearest_views(images, tracks)
    result = np.full((len(tracks.xyz), len(HEIGHTS)), np.nan)
    with progress_bar("compared with the ground", len(images)) as advance:
        for view in range(len(images)):
            rows = np.flatnonzero(nearest == view)
            if len(rows):
                xyz, xy = tracks.xyz[rows], blobs[view].xy[row[rows]]
                z = xyz[:, 2, None] + (HEIGHTS - above[rows][:, None])
                windows = _cut_windows(images[view], read_photograph(view), xy, z)
                result[rows] = _mean_difference(images, view, read_photograph, windows, xyz)
            advance(view + 1)
    return result


def _cut_windows(
    image: MapImage,
    picture: NDArray[np.float32],
    xy: NDArray[np.float64],
    z: NDArray[np.float64],
) -> _Windows:
    """Cut windows around pixels (N, 2) of a photograph, and cast their rays to heights (N, H)."""
    radius = _RADIUS_PX
    offsets = np.arange(-radius, radius + 1)
    window = np.array([(x, y) for x in offsets for y in offsets if x * x + y * y <= radius**2 + 1])
    pixels = xy[:, None] + window
    colours = _sample(picture, pixels)
    centre_colours = colours[:, len(window) // 2, None]
    weights = np.exp(-np.abs(colours - centre_colours).sum(2) / _COLOUR_SCALE)
    weights *= np.exp(-(window**2).sum(1) / _DISTANCE_SCALE)
    weights /= weights.sum(1, keepdims=True)
    rays, _ = image.camera.unproject(torch.from_numpy(pixels.reshape(-1, 2)))
    directions = (rays.numpy() @ image.cam_from_world[:3, :3]).reshape(*pixels.shape[:2], 3)
    scales = (z[:, :, None] - image.centre[2]) / directions[:, None, :, 2]
    return _Windows(colours, weights, image.centre + directions[:, None] * scales[..., None])


def _mean_difference(
    images: Sequence[MapImage],
    view: int,
    read_photograph: LruCache[int, NDArray[np.float32]],
    windows: _Windows,
    xyz: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the mean difference (N, H) over the other photographs that show each point."""
    total, view_count = np.zeros((len(xyz), len(HEIGHTS))), np.zeros((len(xyz), 1))
    for other, image in enumerate(images):
        if other == view:
            continue
        in_view = np.flatnonzero(project(image, xyz)[1])
        if not len(in_view):
            continue
        points = windows.xyz[in_view]
        xy, _ = project(image, points.reshape(-1, 3))
        colours = _sample(read_photograph(other), xy.reshape(*points.shape[:3], 2))
        difference = np.abs(colours - windows.colours[in_view][:, None]).sum(3)
        difference = difference.clip(max=_MAX_DIFFERENCE)
        total[in_view] += (difference * windows.weights[in_view][:, None]).sum(2)
        view_count[in_view] += 1
    return np.where(view_count > 0, total / view_count.clip(1), np.nan)


def _find_nearest_views(
    images: Sequence[MapImage], tracks: Tracks
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the horizontally nearest photograph of each point, and the row of its blob there."""
    centres = np.array([image.centre for image in images])
    distance = np.linalg.norm((tracks.xyz[tracks.track] - centres[tracks.view])[:, :2], axis=1)
    order = np.lexsort((distance, tracks.track))
    _, first = np.unique(tracks.track[order], return_index=True)
    return tracks.view[order[first]], tracks.row[order[first]]


class RelativeCosts(NamedTuple):
    """Costs of T points relative to the costs at the ground below them.

    Attributes:
        least_ratio: ratio (T,) of the minimum cost to the cost at the ground; infinite if unknown.
        distance_m: distance (T,) between the height of the minimum cost and the point, metres.
        ground_cost: cost (T,) at the ground.
        ratios: ratios (T, H) of the costs at ``HEIGHTS`` to the cost at the ground.
    """

    least_ratio: NDArray[np.float64]
    distance_m: NDArray[np.float64]
    ground_cost: NDArray[np.float64]
    ratios: NDArray[np.float64]


def compare_with_ground(costs: NDArray[np.float64], height: NDArray[np.float64]) -> RelativeCosts:
    """Compare the costs of points with the costs at the ground below them.

    Args:
        costs: result (T, H) of ``compute_costs``.
        height: heights (T,) of the points above the ground, metres.
    """
    known = np.where(np.isnan(costs), _UNKNOWN, costs)
    ground_cost = known[:, _IS_GROUND].min(1)
    ratios = known / np.maximum(ground_cost, 1e-9)[:, None]
    least = np.where(np.isnan(costs).all(1), np.inf, ratios.min(1))
    return RelativeCosts(least, np.abs(HEIGHTS[known.argmin(1)] - height), ground_cost, ratios)


def _sample(picture: NDArray[np.float32], xy: NDArray[np.float64]) -> NDArray[np.float32]:
    """Sample a picture at pixels (..., 2), and return colours (..., 3)."""
    # OpenCV's origin is the centre of the first pixel.
    flat = (xy.reshape(-1, 2) - 0.5).astype(np.float32)
    parts = [
        cv2.remap(picture, part[:, :1], part[:, 1:], cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
        for part in np.array_split(flat, 1 + len(flat) // _ROWS)
    ]
    return np.asarray(np.concatenate(parts).reshape(*xy.shape[:-1], 3), np.float32)
