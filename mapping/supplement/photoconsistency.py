"""Whether photographs agree on a place where it was found, and not on the ground under it.

Most pixels around a thin object show the ground, and a plain window would say so. Each pixel
counts here as far as it has the colour of the place (Yoon and Kweon, "Adaptive support-weight
approach for correspondence search", PAMI 2006).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from mapping.supplement.blobs import Blobs, in_lab
from mapping.supplement.ground_plane import Ground
from mapping.supplement.tracks import Tracks, project
from scene.maps.sparse_map import MapImage
from scene.runtime.progress import progress_bar
from scene.storage.images import read_rgb

# Heights above the ground that are compared (m); those of the ground itself.
HEIGHTS: Final = np.arange(-0.45, 3.5, 0.15)
_GROUND: Final = np.abs(HEIGHTS) < 0.16
# The window: pixels within this of the middle; how fast they count less beside it (px) and of
# another colour (L*a*b*), and the difference from which on a pixel is no match at all.
_REACH: Final = 2
_FADE: Final = 6.0
_SOFT: Final = 8.0
_DIFFERENT: Final = 15.0
_BLUR_PX: Final = 0.5
_HELD: Final = 16
_ROWS: Final = 30000


def costs(
    images: Sequence[MapImage],
    folder: Path,
    blobs: Sequence[Blobs],
    ground: Ground,
    tracks: Tracks,
) -> NDArray[np.float64]:
    """Mean difference of the colours around places, at each of ``HEIGHTS``, (T, H).

    The window is that of the photograph that looks down most steeply, held against all that have
    the place in their picture; NaN where no other has.

    Args:
        images: photographs.
        folder: where their files are.
        blobs: of each.
        ground: under them.
        tracks: places.

    Raises:
        InputError: a photograph is missing or damaged.
    """
    held: OrderedDict[int, NDArray[np.float32]] = OrderedDict()

    def look(view: int) -> NDArray[np.float32]:
        if view not in held:
            image = images[view]
            lab = in_lab(read_rgb(folder / image.name, image.camera))
            held[view] = np.asarray(cv2.GaussianBlur(lab, (0, 0), _BLUR_PX), np.float32)
            while len(held) > _HELD:
                held.popitem(last=False)
        held.move_to_end(view)
        return held[view]

    unit = np.arange(-_REACH, _REACH + 1)
    window = np.array([(x, y) for x in unit for y in unit if x * x + y * y <= _REACH**2 + 1])
    above = HEIGHTS - (tracks.xyz[:, 2] - ground.at(tracks.xyz[:, :2]))[:, None]
    steepest, row = _steepest(images, tracks)
    found = np.full((len(tracks.xyz), len(HEIGHTS)), np.nan)
    with progress_bar("held against the ground", len(images)) as advance:
        for view, image in enumerate(images):
            at = np.flatnonzero(steepest == view)
            if len(at):
                pixels = blobs[view].xy[row[at]][:, None] + window
                own = _looked_up(look(view), pixels)
                middle = own[:, len(window) // 2, None]
                weight = np.exp(-np.abs(own - middle).sum(2) / _SOFT)
                weight *= np.exp(-(window**2).sum(1) / _FADE)
                weight /= weight.sum(1, keepdims=True)
                rays, _ = image.camera.unproject(torch.from_numpy(pixels.reshape(-1, 2)))
                toward = (rays.numpy() @ image.cam_from_world[:3, :3]).reshape(*pixels.shape[:2], 3)
                z = tracks.xyz[at, 2, None] + above[at]
                along = (z[:, :, None] - image.centre[2]) / toward[:, None, :, 2]
                places = image.centre + toward[:, None] * along[..., None]
                total, views = np.zeros((len(at), len(HEIGHTS))), np.zeros((len(at), 1))
                for other in range(len(images)):
                    inside = other != view and project(images[other], tracks.xyz[at])[1]
                    seen = np.flatnonzero(inside)
                    if other == view or not len(seen):
                        continue
                    xy, _ = project(images[other], places[seen].reshape(-1, 3))
                    theirs = _looked_up(look(other), xy.reshape(*places[seen].shape[:3], 2))
                    off = np.abs(theirs - own[seen][:, None]).sum(3).clip(max=_DIFFERENT)
                    total[seen] += (off * weight[seen][:, None]).sum(2)
                    views[seen] += 1
                found[at] = np.where(views > 0, total / views.clip(1), np.nan)
            advance(view + 1)
    return found


def _steepest(
    images: Sequence[MapImage], tracks: Tracks
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Of each place the photograph that looks down on it most steeply, and its blob there."""
    centres = np.array([image.centre for image in images])
    beside = np.linalg.norm((tracks.xyz[tracks.track] - centres[tracks.view])[:, :2], axis=1)
    order = np.lexsort((beside, tracks.track))
    _, first = np.unique(tracks.track[order], return_index=True)
    return tracks.view[order[first]], tracks.row[order[first]]


class BesideGround(NamedTuple):
    """Costs of T places beside those of the ground under them.

    Attributes:
        share: (T,) the least, as a share of that at the ground; infinite where nothing is known.
        off: (T,) how far the height of the least is from the place's (m).
        on_ground: (T,) cost there.
        curve: (T, H) at ``HEIGHTS``, as shares of it.
    """

    share: NDArray[np.float64]
    off: NDArray[np.float64]
    on_ground: NDArray[np.float64]
    curve: NDArray[np.float64]


def costs_beside_ground(found: NDArray[np.float64], height: NDArray[np.float64]) -> BesideGround:
    """Of costs (T, H) as ``costs`` gives them, and heights (T,) of the places above the ground."""
    known = np.where(np.isnan(found), _DIFFERENT, found)
    on_ground = known[:, _GROUND].min(1)
    curve = known / np.maximum(on_ground, 1e-9)[:, None]
    share = np.where(np.isnan(found).all(1), np.inf, curve.min(1))
    return BesideGround(share, np.abs(HEIGHTS[known.argmin(1)] - height), on_ground, curve)


def _looked_up(picture: NDArray[np.float32], xy: NDArray[np.float64]) -> NDArray[np.float32]:
    """Values (..., 3) of a picture at pixels (..., 2)."""
    # OpenCV counts from the first pixel's centre, and takes so many rows at most.
    flat = (xy.reshape(-1, 2) - 0.5).astype(np.float32)
    parts = [
        cv2.remap(picture, part[:, :1], part[:, 1:], cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
        for part in np.array_split(flat, 1 + len(flat) // _ROWS)
    ]
    return np.asarray(np.concatenate(parts).reshape(*xy.shape[:-1], 3), np.float32)
