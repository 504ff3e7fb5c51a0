"""Tracks: blobs of several photographs that show one place a little above the ground."""

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

# Heights above the ground that are tried (m): from below a slope to the roof of a van.
_LOWEST_M: Final = -0.75
_HIGHEST_M: Final = 3.3
_HEIGHT_STEP_M: Final = 0.25
# Most photographs that each photograph is compared with, and the least share of the same ground
# that they must show.
_MAX_PHOTOGRAPHS: Final = 24
_MIN_OVERLAP: Final = 0.05
# Blobs match within these limits: distance (px) from the projection of a place, cosine of the
# appearances, ratio of the weaker to the stronger contrast, difference of colours (CIE L*a*b*).
# The classifier was trained with places that they let through.
_MAX_OFFSET_PX: Final = 1.3
_MIN_COSINE: Final = 0.75
_MIN_STRENGTH_RATIO: Final = 0.4
_MAX_COLOUR_DIFFERENCE: Final = 15.0
# Gauss-Newton steps that refine the places, and those before outliers are dropped.
_STEPS: Final = 4
_SETTLING: Final = 2
# Observations with a larger reprojection error (px) leave a place.
_MAX_ERROR_PX: Final = 1.5
# Pixels at the edge in which a place does not count as visible: a blob there has no surroundings.
_BORDER_PX: Final = 4.0
# Least share of its blobs that no better place has taken, for a place to stay.
_MIN_FREE_SHARE: Final = 0.7
# Cells per pixel of the table in which the nearest blob is looked up.
_CELLS: Final = 2


@dataclass(frozen=True)
class Tracks:
    """T places, with O observations.

    Attributes:
        xyz: positions (T, 3), world metres.
        visible: number (T,) of compared photographs whose picture contains the place.
        error_px: mean reprojection error (T,); infinite before refinement.
        track, view, row: place, photograph and blob of each observation, (O,).
    """

    xyz: NDArray[np.float64]
    visible: NDArray[np.int64]
    error_px: NDArray[np.float64]
    track: NDArray[np.int64]
    view: NDArray[np.int64]
    row: NDArray[np.int64]

    @property
    def views(self) -> NDArray[np.int64]:
        """Count the observations of each place, (T,)."""
        return np.bincount(self.track, minlength=len(self.xyz))

    def only(self, kept: NDArray[np.bool_]) -> Tracks:
        """Select places by a mask (T,)."""
        number = np.cumsum(kept) - 1
        mine = kept[self.track]
        return Tracks(
            self.xyz[kept],
            self.visible[kept],
            self.error_px[kept],
            number[self.track[mine]],
            self.view[mine],
            self.row[mine],
        )


@dataclass(frozen=True)
class _Compared:
    """The photographs that are compared.

    Attributes:
        images: photographs.
        blobs: blobs of each photograph.
        tables: result of ``_nearest_blobs`` for each photograph.
        ground: the ground under them.
    """

    images: Sequence[MapImage]
    blobs: Sequence[Blobs]
    tables: Sequence[NDArray[np.int32]]
    ground: Ground


def follow(
    images: Sequence[MapImage],
    blobs: Sequence[Blobs],
    ground: Ground,
    views: int,
) -> Tracks:
    """Find the height above the ground of every blob: the one at which most photographs match it.

    Args:
        images: photographs of the map.
        blobs: blobs of each photograph.
        ground: the ground.
        views: least number of photographs that show a place, including its own.
    """
    shapes = [(image.camera.height, image.camera.width) for image in images]
    tables = [_nearest_blobs(each, shape) for each, shape in zip(blobs, shapes, strict=True)]
    compared = _Compared(images, blobs, tables, ground)
    parts = []
    with progress_bar("compare", len(images)) as advance:
        for view in range(len(images)):
            parts.append(_follow_one(view, compared, views))
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


def _nearest_blobs(blobs: Blobs, shape: tuple[int, int]) -> NDArray[np.int32]:
    """Tabulate the nearest blob within reach of each cell, -1 for none, by radius, row and column.

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
        table[blobs.radius, row + y, column + x] = number
    return table[:, reach:-reach, reach:-reach]


def project(
    image: MapImage, xyz: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Project places to pixels (N, 2); also return which lie inside the border, (N,)."""
    seen = image.camera.project(image.pose.transform(torch.from_numpy(xyz)))
    return seen.xy.numpy(), (seen.valid & image.camera.contains(seen.xy, _BORDER_PX)).numpy()


def _follow_one(view: int, compared: _Compared, views: int) -> Tracks:
    """Follow the blobs of one photograph, given by its row, into the others; see ``follow``."""
    images, blobs, ground = compared.images, compared.blobs, compared.ground
    own = blobs[view]
    heights = np.arange(_LOWEST_M, _HIGHEST_M, _HEIGHT_STEP_M)
    low = ground.under(images[view], own.xy, 0.0)
    up = ground.under(images[view], own.xy, 1.0) - low
    places = (low[:, None] + up[:, None] * heights[:, None]).reshape(-1, 3)
    owner = np.repeat(np.arange(len(low)), len(heights))
    others = _overlapping(view, images, low)
    score = np.zeros(len(places))
    visible = np.zeros(len(places), np.int64)
    members = np.full((len(others), len(places)), -1, np.int32)
    for k, other in enumerate(others):
        xy, inside = project(images[other], places)
        visible += inside
        at = np.flatnonzero(inside)
        at, blob, match_score = _match(
            own, owner[at], blobs[other], compared.tables[other], (at, xy[at])
        )
        score[at] += match_score
        members[k, at] = blob
    best = score.reshape(-1, len(heights)).argmax(1) + len(heights) * np.arange(len(low))
    chosen = members[:, best]
    enough = (chosen >= 0).sum(0) >= views - 1
    best, chosen, row = best[enough], chosen[:, enough], np.flatnonzero(enough)
    which, track = np.nonzero(chosen >= 0)
    number = np.arange(len(best))
    return Tracks(
        places[best],
        visible[best] + 1,
        np.full(len(best), np.inf),
        np.concatenate([number, track]),
        np.concatenate([np.full(len(best), view), np.array(others, np.int64)[which]]),
        np.concatenate([row, chosen[which, track]]),
    )


def _overlapping(view: int, images: Sequence[MapImage], ground: NDArray[np.float64]) -> list[int]:
    """Return the photographs that show most of the ground (N, 3) under a photograph's blobs."""
    overlap = [
        0.0 if k == view or not len(ground) else float(project(image, ground[::50])[1].mean())
        for k, image in enumerate(images)
    ]
    order = np.argsort(-np.array(overlap), kind="stable")[:_MAX_PHOTOGRAPHS]
    return [k for k in order.tolist() if overlap[k] > _MIN_OVERLAP]


def _match(
    own: Blobs,
    rows: NDArray[np.int64],
    theirs: Blobs,
    table: NDArray[np.int32],
    projected: tuple[NDArray[np.int64], NDArray[np.float64]],
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64]]:
    """Match places of a photograph's blobs to the nearest blobs of another.

    Args:
        own: blobs of the photograph.
        rows: row (P,) of the blob of each place.
        theirs: blobs of the other photograph.
        table: result of ``_nearest_blobs`` for the other photograph.
        projected: numbers (P,) of the places, and pixels (P, 2) of the other photograph.

    Returns:
        The numbers of the places that match, the rows of their blobs, and the scores.
    """
    at, xy = projected
    column, row = (xy * _CELLS).astype(int).T
    blob = table[own.radius[rows], row, column]
    some = np.flatnonzero(blob >= 0)
    offset = np.linalg.norm(theirs.xy[blob[some]] - xy[some], axis=1)
    near = offset < _MAX_OFFSET_PX
    some, offset = some[near], offset[near]
    cosine, similar = _similar(own, rows[some], theirs, blob[some])
    some, cosine, offset = some[similar], cosine[similar], offset[similar]
    return at[some], blob[some], cosine * (1 - 0.5 * (offset / _MAX_OFFSET_PX) ** 2)


def _similar(
    a: Blobs,
    rows_a: NDArray[np.int64],
    b: Blobs,
    rows_b: NDArray[np.int32],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the cosine of the appearances of pairs of blobs, and which pairs match, (P,)."""
    look_a, look_b = a.look[rows_a], b.look[rows_b]
    lengths = np.linalg.norm(look_a, axis=1) * np.linalg.norm(look_b, axis=1)
    cosine = (look_a * look_b).sum(1) / lengths.clip(1e-6)
    strong, weak = a.strength[rows_a], b.strength[rows_b]
    same = np.minimum(strong, weak) > _MIN_STRENGTH_RATIO * np.maximum(strong, weak)
    difference = np.linalg.norm(a.colour[rows_a] - b.colour[rows_b], axis=1)
    same &= difference < _MAX_COLOUR_DIFFERENCE
    return cosine, (cosine > _MIN_COSINE) & same


def solve(
    images: Sequence[MapImage],
    blobs: Sequence[Blobs],
    tracks: Tracks,
    views: int,
) -> Tracks:
    """Move places to their least reprojection error by Gauss-Newton with Cauchy's weights.

    Observations with too large an error are dropped, and places with fewer than ``views`` of them.
    """
    for round_ in range(_STEPS + 1):
        count = len(tracks.xyz)
        normal, right = np.tile(1e-9 * np.eye(3), (count, 1, 1)), np.zeros((count, 3))
        error = np.full(len(tracks.track), np.inf)
        for view, image in enumerate(images):
            at = np.flatnonzero(tracks.view == view)
            if not len(at):
                continue
            of = tracks.track[at]
            local = image.pose.transform(torch.from_numpy(tracks.xyz[of]))
            seen = image.camera.project(local, jacobian=True)
            assert seen.jacobian is not None
            off = blobs[view].xy[tracks.row[at]] - seen.xy.numpy()
            error[at] = np.where(seen.valid.numpy(), np.linalg.norm(off, axis=1), np.inf)
            known = np.isfinite(error[at])
            slope = (seen.jacobian.numpy() @ image.cam_from_world[:3, :3])[known]
            weight = 1 / (1 + error[at][known] ** 2)
            normal[of[known]] += np.einsum("nij,nik,n->njk", slope, slope, weight)
            right[of[known]] += np.einsum("nij,ni,n->nj", slope, off[known], weight)
        if round_ < _STEPS:
            step = np.linalg.solve(normal, right[..., None])[..., 0]
            tracks = replace(tracks, xyz=tracks.xyz + step)
        if round_ >= _SETTLING:
            good = error < _MAX_ERROR_PX
            tracks = replace(
                tracks, track=tracks.track[good], view=tracks.view[good], row=tracks.row[good]
            )
            error = error[good]
    mean = np.bincount(tracks.track, error, len(tracks.xyz)) / tracks.views.clip(1)
    tracks = replace(tracks, error_px=mean)
    return tracks.only(tracks.views >= views)


def distinct(tracks: Tracks, views: int) -> Tracks:
    """Assign each blob to one place, first to places with most photographs and least error.

    Places that lose too large a share of their blobs to others are dropped, and places with fewer
    than ``views`` of them.
    """
    order = np.argsort(-(tracks.views - tracks.error_px), kind="stable")
    by_track = np.argsort(tracks.track, kind="stable")
    ends = np.concatenate([[0], np.cumsum(tracks.views)])
    keys = list(zip(tracks.view.tolist(), tracks.row.tolist(), strict=True))
    taken: set[tuple[int, int]] = set()
    kept, free = np.zeros(len(tracks.xyz), bool), np.zeros(len(tracks.track), bool)
    for track in order.tolist():
        mine = by_track[ends[track] : ends[track + 1]].tolist()
        left = [k for k in mine if keys[k] not in taken]
        if len(left) >= max(views, _MIN_FREE_SHARE * len(mine)):
            kept[track] = free[left] = True
            taken.update(keys[k] for k in left)
    tracks = replace(tracks, track=tracks.track[free], view=tracks.view[free], row=tracks.row[free])
    return tracks.only(kept)
