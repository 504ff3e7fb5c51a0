"""Build tracks: blobs of several photographs that show one point a little above the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.mapping.supplement.blobs import SIGMAS, Blobs
from objconnect.mapping.supplement.ground_plane import Ground
from objconnect.scene.maps.sparse_map import MapImage
from objconnect.scene.runtime.progress import progress_bar

# Tested heights (m) above the estimated ground. They start below it, because the estimate may be
# too high on a slope, and end at the roof of a van.
_LOWEST_M: Final = -0.75
_HIGHEST_M: Final = 3.3
_HEIGHT_STEP_M: Final = 0.25
# Maximum number of photographs with which each one is compared, and their minimum overlap.
_MAX_PHOTOGRAPHS: Final = 24
_MIN_OVERLAP: Final = 0.05
# Blobs match within these limits: distance (px) from the projection of a point, cosine of the
# appearances, ratio of the weaker to the stronger contrast, difference of colours (CIE L*a*b*).
# The classifier was trained with these limits.
_MAX_OFFSET_PX: Final = 1.3
_MIN_COSINE: Final = 0.75
_MIN_STRENGTH_RATIO: Final = 0.4
_MAX_COLOUR_DIFFERENCE: Final = 15.0
# Gauss-Newton steps that refine points, and the number of steps before outliers are dropped.
_STEPS: Final = 4
_STEPS_WITH_OUTLIERS: Final = 2
# Observations with a larger reprojection error (px) are dropped.
_MAX_ERROR_PX: Final = 1.5
# Width (px) of the border in which a point is not visible, because blobs need surroundings.
_BORDER_PX: Final = 4.0
# Minimum share of a track's blobs that no better track uses.
_MIN_FREE_SHARE: Final = 0.7
# Cells per pixel of the lookup table of the nearest blob.
_CELLS: Final = 2


@dataclass(frozen=True)
class Tracks:
    """T tracks with O observations.

    Attributes:
        xyz: points (T, 3), world metres.
        visible: number (T,) of compared photographs whose picture contains the point.
        error_px: mean reprojection error (T,); infinite before refinement.
        track: track of each observation, (O,).
        view: photograph of each observation, (O,).
        row: blob of each observation, (O,).
    """

    xyz: NDArray[np.float64]
    visible: NDArray[np.int64]
    error_px: NDArray[np.float64]
    track: NDArray[np.int64]
    view: NDArray[np.int64]
    row: NDArray[np.int64]

    @property
    def views(self) -> NDArray[np.int64]:
        """Return the number of observations of each track, (T,)."""
        return np.bincount(self.track, minlength=len(self.xyz))

    def select(self, kept: NDArray[np.bool_]) -> Tracks:
        """Select tracks by a mask (T,)."""
        number = np.cumsum(kept) - 1
        is_kept = kept[self.track]
        return Tracks(
            self.xyz[kept],
            self.visible[kept],
            self.error_px[kept],
            number[self.track[is_kept]],
            self.view[is_kept],
            self.row[is_kept],
        )


@dataclass(frozen=True)
class _Photographs:
    """The photographs to compare.

    Attributes:
        images: photographs.
        blobs: blobs of each photograph.
        tables: result of ``_tabulate_blobs`` for each photograph.
        ground: the ground under them.
    """

    images: Sequence[MapImage]
    blobs: Sequence[Blobs]
    tables: Sequence[NDArray[np.int32]]
    ground: Ground


def follow_blobs(
    images: Sequence[MapImage],
    blobs: Sequence[Blobs],
    ground: Ground,
    min_views: int,
) -> Tracks:
    """Find the height above the ground at which each blob matches other photographs best.

    Args:
        images: photographs of the map.
        blobs: blobs of each photograph.
        ground: the ground.
        min_views: minimum number of observations of a track, including the blob itself.
    """
    shapes = [(image.camera.height, image.camera.width) for image in images]
    tables = [_tabulate_blobs(each, shape) for each, shape in zip(blobs, shapes, strict=True)]
    photographs = _Photographs(images, blobs, tables, ground)
    parts = []
    with progress_bar("compare", len(images)) as advance:
        for view in range(len(images)):
            parts.append(_follow_one(view, photographs, min_views))
            advance(view + 1)
    first = np.cumsum([0] + [len(part.xyz) for part in parts])
    return Tracks(
        np.concatenate([part.xyz for part in parts]),
        np.concatenate([part.visible for part in parts]),
        np.concatenate([part.error_px for part in parts]),
        np.concatenate([part.track + k for part, k in zip(parts, first[:-1], strict=True)]),
        np.concatenate([part.view for part in parts]),
        np.concatenate([part.row for part in parts]),
    )


def _tabulate_blobs(blobs: Blobs, shape: tuple[int, int]) -> NDArray[np.int32]:
    """Tabulate the nearest blob within reach of each cell, by radius, row and column; -1 is none.

    Args:
        blobs: blobs of one photograph.
        shape: height and width of the photograph.
    """
    reach = int(_CELLS * _MAX_OFFSET_PX) + 1
    steps = [(x, y) for x in range(-reach, reach + 1) for y in range(-reach, reach + 1)]
    table = np.full((len(SIGMAS), *(_CELLS * side + 2 * reach for side in shape)), -1, np.int32)
    column, row = np.floor(blobs.xy * _CELLS).astype(int).T + reach
    number = np.arange(len(column))
    # Nearer blobs overwrite farther ones.
    for x, y in sorted(steps, key=lambda step: -(step[0] ** 2 + step[1] ** 2)):
        table[blobs.radius_index, row + y, column + x] = number
    return table[:, reach:-reach, reach:-reach]


def project(
    image: MapImage, xyz: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Project points (N, 3) to pixels (N, 2); also return which are visible, (N,).

    A point is visible if its pixel lies in the image and not in the border of ``_BORDER_PX``.
    """
    projected = image.camera.project(image.pose.transform(torch.from_numpy(xyz)))
    inside = projected.valid & image.camera.contains(projected.xy, _BORDER_PX)
    return projected.xy.numpy(), inside.numpy()


def _follow_one(view: int, photographs: _Photographs, min_views: int) -> Tracks:
    """Follow the blobs of photograph ``view`` into the others; see ``follow_blobs``."""
    images, blobs, ground = photographs.images, photographs.blobs, photographs.ground
    source = blobs[view]
    heights = np.arange(_LOWEST_M, _HIGHEST_M, _HEIGHT_STEP_M)
    at_ground = ground.intersect_rays(images[view], source.xy, 0.0)
    per_metre = ground.intersect_rays(images[view], source.xy, 1.0) - at_ground
    points = (at_ground[:, None] + per_metre[:, None] * heights[:, None]).reshape(-1, 3)
    owner = np.repeat(np.arange(len(at_ground)), len(heights))
    others = _find_overlapping(view, images, at_ground)
    score = np.zeros(len(points))
    visible = np.zeros(len(points), np.int64)
    members = np.full((len(others), len(points)), -1, np.int32)
    for k, other in enumerate(others):
        xy, inside = project(images[other], points)
        visible += inside
        at = np.flatnonzero(inside)
        at, blob, match_score = _match(
            source, owner[at], blobs[other], photographs.tables[other], (at, xy[at])
        )
        score[at] += match_score
        members[k, at] = blob
    best = score.reshape(-1, len(heights)).argmax(1) + len(heights) * np.arange(len(at_ground))
    chosen = members[:, best]
    enough = (chosen >= 0).sum(0) >= min_views - 1
    best, chosen, row = best[enough], chosen[:, enough], np.flatnonzero(enough)
    which, track = np.nonzero(chosen >= 0)
    number = np.arange(len(best))
    return Tracks(
        points[best],
        visible[best] + 1,
        np.full(len(best), np.inf),
        np.concatenate([number, track]),
        np.concatenate([np.full(len(best), view), np.array(others, np.int64)[which]]),
        np.concatenate([row, chosen[which, track]]),
    )


def _find_overlapping(
    view: int, images: Sequence[MapImage], ground: NDArray[np.float64]
) -> list[int]:
    """Return the photographs that see the most ground points (N, 3) of the blobs of ``view``.

    They are sorted by the share of the points that they see, largest first.
    """
    overlap = [
        # A sample of the blobs is enough.
        0.0 if k == view or not len(ground) else float(project(image, ground[::50])[1].mean())
        for k, image in enumerate(images)
    ]
    order = np.argsort(-np.array(overlap), kind="stable")[:_MAX_PHOTOGRAPHS]
    return [k for k in order.tolist() if overlap[k] > _MIN_OVERLAP]


def _match(
    source: Blobs,
    rows: NDArray[np.int64],
    target: Blobs,
    table: NDArray[np.int32],
    projected: tuple[NDArray[np.int64], NDArray[np.float64]],
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64]]:
    """Match points on the rays of a photograph's blobs to the nearest blobs of another.

    Args:
        source: blobs of the photograph.
        rows: row (P,) of the blob of each point.
        target: blobs of the other photograph.
        table: result of ``_tabulate_blobs`` for the other photograph.
        projected: indices (P,) of the points, and their pixels (P, 2) in the other photograph.

    Returns:
        The indices of the points that match, the rows of their blobs, and the scores.
    """
    at, xy = projected
    column, row = (xy * _CELLS).astype(int).T
    blob = table[source.radius_index[rows], row, column]
    hits = np.flatnonzero(blob >= 0)
    offset = np.linalg.norm(target.xy[blob[hits]] - xy[hits], axis=1)
    near = offset < _MAX_OFFSET_PX
    hits, offset = hits[near], offset[near]
    cosine, similar = _compare(source, rows[hits], target, blob[hits])
    hits, cosine, offset = hits[similar], cosine[similar], offset[similar]
    return at[hits], blob[hits], cosine * (1 - 0.5 * (offset / _MAX_OFFSET_PX) ** 2)


def _compare(
    a: Blobs,
    rows_a: NDArray[np.int64],
    b: Blobs,
    rows_b: NDArray[np.int32],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the cosine of the appearances of P pairs of blobs, and the mask of matches."""
    appearance_a, appearance_b = a.appearance[rows_a], b.appearance[rows_b]
    lengths = np.linalg.norm(appearance_a, axis=1) * np.linalg.norm(appearance_b, axis=1)
    cosine = (appearance_a * appearance_b).sum(1) / lengths.clip(1e-6)
    strength_a, strength_b = a.strength[rows_a], b.strength[rows_b]
    weaker, stronger = np.minimum(strength_a, strength_b), np.maximum(strength_a, strength_b)
    same = weaker > _MIN_STRENGTH_RATIO * stronger
    difference = np.linalg.norm(a.colour[rows_a] - b.colour[rows_b], axis=1)
    same &= difference < _MAX_COLOUR_DIFFERENCE
    return cosine, (cosine > _MIN_COSINE) & same


def refine_tracks(
    images: Sequence[MapImage],
    blobs: Sequence[Blobs],
    tracks: Tracks,
    min_views: int,
) -> Tracks:
    """Minimise the reprojection errors of points by Gauss-Newton with Cauchy weights.

    Observations with too large an error are dropped, and tracks with fewer than ``min_views``
    observations.
    """
    for round_ in range(_STEPS + 1):
        count = len(tracks.xyz)
        normal, right = np.tile(1e-9 * np.eye(3), (count, 1, 1)), np.zeros((count, 3))
        error = np.full(len(tracks.track), np.inf)
        for view, image in enumerate(images):
            at = np.flatnonzero(tracks.view == view)
            if not len(at):
                continue
            owner = tracks.track[at]
            local = image.pose.transform(torch.from_numpy(tracks.xyz[owner]))
            projected = image.camera.project(local, jacobian=True)
            assert projected.jacobian is not None
            residual = blobs[view].xy[tracks.row[at]] - projected.xy.numpy()
            error[at] = np.where(projected.valid.numpy(), np.linalg.norm(residual, axis=1), np.inf)
            known = np.isfinite(error[at])
            derivatives = (projected.jacobian.numpy() @ image.cam_from_world[:3, :3])[known]
            weight = 1 / (1 + error[at][known] ** 2)
            normal[owner[known]] += np.einsum("nij,nik,n->njk", derivatives, derivatives, weight)
            right[owner[known]] += np.einsum("nij,ni,n->nj", derivatives, residual[known], weight)
        if round_ < _STEPS:
            step = np.linalg.solve(normal, right[..., None])[..., 0]
            tracks = replace(tracks, xyz=tracks.xyz + step)
        if round_ >= _STEPS_WITH_OUTLIERS:
            good = error < _MAX_ERROR_PX
            tracks = replace(
                tracks, track=tracks.track[good], view=tracks.view[good], row=tracks.row[good]
            )
            error = error[good]
    mean = np.bincount(tracks.track, error, len(tracks.xyz)) / tracks.views.clip(1)
    tracks = replace(tracks, error_px=mean)
    return tracks.select(tracks.views >= min_views)


def drop_overlapping(tracks: Tracks, min_views: int) -> Tracks:
    """Assign each blob to one track, the best of those that share it.

    Tracks are ranked by their number of observations minus their mean error in pixels.

    Tracks that lose too large a share of their blobs to others are dropped, and tracks with fewer
    than ``min_views`` blobs.
    """
    order = np.argsort(-(tracks.views - tracks.error_px), kind="stable")
    by_track = np.argsort(tracks.track, kind="stable")
    ends = np.concatenate([[0], np.cumsum(tracks.views)])
    keys = list(zip(tracks.view.tolist(), tracks.row.tolist(), strict=True))
    used_blobs: set[tuple[int, int]] = set()
    kept, free = np.zeros(len(tracks.xyz), bool), np.zeros(len(tracks.track), bool)
    for track in order.tolist():
        observations = by_track[ends[track] : ends[track + 1]].tolist()
        left = [k for k in observations if keys[k] not in used_blobs]
        if len(left) >= max(min_views, _MIN_FREE_SHARE * len(observations)):
            kept[track] = free[left] = True
            used_blobs.update(keys[k] for k in left)
    tracks = replace(tracks, track=tracks.track[free], view=tracks.view[free], row=tracks.row[free])
    return tracks.select(kept)
