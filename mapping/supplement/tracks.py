"""Blobs of several photographs that are one place a little above the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from mapping.supplement.blobs import SIGMAS, Blobs
from mapping.supplement.ground_plane import Ground
from scene.maps.sparse_map import MapImage
from scene.runtime.progress import progress_bar

# Heights above the ground that a blob may have (m).
_HEIGHTS: Final = np.arange(-0.75, 3.3, 0.25)
# Photographs that a photograph is compared with, if they show so much of the same ground.
_MOST_OTHERS: Final = 24
_LEAST_OVERLAP: Final = 0.05
# Two blobs are alike: pixels beside the projection, cosine of looks, share of strength, colour.
_BESIDE_PX: Final = 1.3
_COSINE: Final = 0.75
_STRENGTH: Final = 0.4
_COLOUR: Final = 15.0
# Cells to a pixel of the picture in which the blob nearest to a pixel is looked up.
_CELLS: Final = 2
_GATE_PX: Final = 1.5
_ROUNDS: Final = 4
_MARGIN: Final = 4.0


@dataclass(frozen=True)
class Tracks:
    """T places, with O observations.

    Attributes:
        xyz: (T, 3) world metres.
        visible: (T,) photographs compared that have the place in their picture.
        error_px: (T,) mean reprojection error; infinite before they are solved.
        track, view, row: (O,) of an observation its place, its photograph and its blob there.
    """

    xyz: NDArray[np.float64]
    visible: NDArray[np.int64]
    error_px: NDArray[np.float64]
    track: NDArray[np.int64]
    view: NDArray[np.int64]
    row: NDArray[np.int64]

    @property
    def views(self) -> NDArray[np.int64]:
        """Observations of each, (T,)."""
        return np.bincount(self.track, minlength=len(self.xyz))

    def only(self, kept: NDArray[np.bool_]) -> Tracks:
        """Some of them (T,)."""
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


def follow(
    images: Sequence[MapImage], blobs: Sequence[Blobs], ground: Ground, views: int
) -> Tracks:
    """For every blob the height above the ground at which most other photographs show it too.

    Args:
        images: photographs.
        blobs: of each.
        ground: under them.
        views: that must show a place, its own among them.
    """
    shapes = [(image.camera.height, image.camera.width) for image in images]
    charts = [_chart(found, shape) for found, shape in zip(blobs, shapes, strict=True)]
    parts = []
    with progress_bar("compare", len(images)) as advance:
        for view in range(len(images)):
            parts.append(_follow(view, images, blobs, charts, ground, views))
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


def _chart(blobs: Blobs, shape: tuple[int, int]) -> NDArray[np.int32]:
    """By radius and cell of the picture, the nearest blob within reach, -1 for none."""
    reach = int(_CELLS * _BESIDE_PX) + 1
    steps = [(x, y) for x in range(-reach, reach + 1) for y in range(-reach, reach + 1)]
    chart = np.full((len(SIGMAS), *(_CELLS * side + 2 * reach for side in shape)), -1, np.int32)
    column, row = np.floor(blobs.xy * _CELLS).astype(int).T + reach
    number = np.arange(len(column))
    # The nearer overwrite the farther.
    for x, y in sorted(steps, key=lambda step: -(step[0] ** 2 + step[1] ** 2)):
        chart[blobs.radius, row + y, column + x] = number
    return chart[:, reach:-reach, reach:-reach]


def project(
    image: MapImage, xyz: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Pixels (N, 2) of places in the world, and whether they lie well in the picture, (N,)."""
    seen = image.camera.project(image.pose.transform(torch.from_numpy(xyz)))
    return seen.xy.numpy(), (seen.valid & image.camera.contains(seen.xy, _MARGIN)).numpy()


def _follow(
    view: int,
    images: Sequence[MapImage],
    blobs: Sequence[Blobs],
    charts: Sequence[NDArray[np.int32]],
    ground: Ground,
    views: int,
) -> Tracks:
    mine, heights = blobs[view], len(_HEIGHTS)
    low = ground.under(images[view], mine.xy, 0.0)
    up = ground.under(images[view], mine.xy, 1.0) - low
    places = (low[:, None] + up[:, None] * _HEIGHTS[:, None]).reshape(-1, 3)
    owner = np.repeat(np.arange(len(low)), heights)
    overlap = [
        0.0 if k == view or not len(low) else float(project(image, low[::50])[1].mean())
        for k, image in enumerate(images)
    ]
    others = [
        k
        for k in np.argsort(-np.array(overlap), kind="stable")[:_MOST_OTHERS].tolist()
        if overlap[k] > _LEAST_OVERLAP
    ]
    score = np.zeros(len(places))
    visible = np.zeros(len(places), np.int64)
    members = np.full((len(others), len(places)), -1, np.int32)
    for k, other in enumerate(others):
        there = blobs[other]
        xy, inside = project(images[other], places)
        visible += inside
        at = np.flatnonzero(inside)
        column, row = (xy[at] * _CELLS).astype(int).T
        blob = charts[other][mine.radius[owner[at]], row, column]
        at, blob = at[blob >= 0], blob[blob >= 0]
        beside = np.linalg.norm(there.xy[blob] - xy[at], axis=1)
        near = beside < _BESIDE_PX
        at, blob, beside = at[near], blob[near], beside[near]
        cosine, alike = _alike(mine, owner[at], there, blob)
        at, blob = at[alike], blob[alike]
        score[at] += cosine[alike] * (1 - 0.5 * (beside[alike] / _BESIDE_PX) ** 2)
        members[k, at] = blob
    best = score.reshape(-1, heights).argmax(1) + heights * np.arange(len(low))
    chosen = members[:, best]
    enough = (chosen >= 0).sum(0) >= views - 1
    best, chosen, own = best[enough], chosen[:, enough], np.flatnonzero(enough)
    which, track = np.nonzero(chosen >= 0)
    number = np.arange(len(best))
    return Tracks(
        places[best],
        visible[best] + 1,
        np.full(len(best), np.inf),
        np.concatenate([number, track]),
        np.concatenate([np.full(len(best), view), np.array(others, np.int64)[which]]),
        np.concatenate([own, chosen[which, track]]),
    )


def _alike(
    a: Blobs, rows_a: NDArray[np.int64], b: Blobs, rows_b: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Cosine of the looks of pairs of blobs, and whether they may be one, (P,) each."""
    look_a, look_b = a.look[rows_a], b.look[rows_b]
    lengths = np.linalg.norm(look_a, axis=1) * np.linalg.norm(look_b, axis=1)
    cosine = (look_a * look_b).sum(1) / lengths.clip(1e-6)
    strong, weak = a.strength[rows_a], b.strength[rows_b]
    same = np.minimum(strong, weak) > _STRENGTH * np.maximum(strong, weak)
    colour = np.linalg.norm(a.colour[rows_a] - b.colour[rows_b], axis=1) < _COLOUR
    return cosine, (cosine > _COSINE) & same & colour


def solve(images: Sequence[MapImage], blobs: Sequence[Blobs], tracks: Tracks, views: int) -> Tracks:
    """Places of least reprojection error (Gauss-Newton, Cauchy's weights); observations beyond
    the gate leave, and places that too few remain of."""
    for round_ in range(_ROUNDS + 1):
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
        if round_ < _ROUNDS:
            step = np.linalg.solve(normal, right[..., None])[..., 0]
            tracks = replace(tracks, xyz=tracks.xyz + step)
        if round_ >= 2:
            good = error < _GATE_PX
            tracks = replace(
                tracks, track=tracks.track[good], view=tracks.view[good], row=tracks.row[good]
            )
            error = error[good]
    mean = np.bincount(tracks.track, error, len(tracks.xyz)) / tracks.views.clip(1)
    tracks = replace(tracks, error_px=mean)
    return tracks.only(tracks.views >= views)


def distinct(tracks: Tracks, views: int) -> Tracks:
    """Each blob to one place: those of most photographs first, then the most exact; what loses
    three of ten of its blobs to others, or has too few left, is no place."""
    order = np.argsort(-(tracks.views - tracks.error_px), kind="stable")
    by_track = np.argsort(tracks.track, kind="stable")
    ends = np.concatenate([[0], np.cumsum(tracks.views)])
    keys = list(zip(tracks.view.tolist(), tracks.row.tolist(), strict=True))
    taken: set[tuple[int, int]] = set()
    kept, free = np.zeros(len(tracks.xyz), bool), np.zeros(len(tracks.track), bool)
    for track in order.tolist():
        mine = by_track[ends[track] : ends[track + 1]].tolist()
        left = [k for k in mine if keys[k] not in taken]
        if len(left) >= max(views, 0.7 * len(mine)):
            kept[track] = free[left] = True
            taken.update(keys[k] for k in left)
    tracks = replace(tracks, track=tracks.track[free], view=tracks.view[free], row=tracks.row[free])
    return tracks.only(kept)
