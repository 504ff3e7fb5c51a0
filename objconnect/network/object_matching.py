"""Matching of a photograph's objects with the landmarks of a map, which gives candidate poses.

For each heading and height to try, the photograph's objects are laid out on level ground and
described among their neighbours. Every object then votes for the camera's position with its most
similar landmarks. The positions with most votes are refined by least squares with the landmarks
near each object.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.localization.coarse.grid import GroundGrid
from objconnect.localization.coarse.search import UP, Candidate
from objconnect.network.constellation import ConstellationGraph
from objconnect.network.detector import Detections
from objconnect.network.landmarks import Landmarks, object_rays
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose, so3_exp

CANDIDATES: Final = 5
"""Default maximum number of candidate poses of a photograph."""
# Least drop of the ray to an object's foot, per unit of depth, for an intersection with level
# ground: flatter rays meet it too far away.
_MIN_LEVEL_DROP: Final = 0.35
# Maximum numbers of similarities and of hypotheses computed at once, which bounds memory.
_AT_ONCE: Final = 8_000_000
_BATCH: Final = 28
# Cells to either side of the origin, more than any map has.
_CELLS: Final = 1 << 20
# Numbers of the most similar landmarks of an object in the vote and in the refinement.
_MATCHES: Final = 6
_CONSIDERED: Final = 16
# Side of the cells of the vote, metres: the error of an object's position.
_CELL_M: Final = 4.0
# Number of positions that are refined, which bounds time, and rounds of the refinement.
_REFINED: Final = 40
_REFINEMENTS: Final = 2
# Standard deviation of a landmark's distance from its object, metres, and least weight of a match
# in the refinement, where 1 is the largest.
_NEAR_M: Final = 2.0
_LEAST_WEIGHT: Final = 0.05
# Least difference of two candidates in position, or else in heading.
_APART_M: Final = 8.0
_APART: Final = math.radians(17)
# Largest change of heading and largest ratio of heights in the refinement: 1.5 times the spacing of
# the hypotheses.
_MOST_TURN: Final = math.radians(23)
_MOST_STRETCH: Final = 1.25
# Least number of objects of a photograph: three fit anything.
_LEAST_OBJECTS: Final = 4
_Vector = NDArray[np.float64]


@dataclass(frozen=True)
class ObjectLayout:
    """N objects on level ground; lengths are in heights of the camera above it.

    Attributes:
        offset: (N, 2) from the point below the camera, to the east and north.
        rise: (N,) heights of the centres above the ground.
        side: (N,) sides.
        vectors: (N, V) of unit length.
        rows: (N,) rows of the photograph's objects.
    """

    offset: _Vector
    rise: _Vector
    side: _Vector
    vectors: Tensor
    rows: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.offset)


def lay_out(found: Detections, camera: Camera, cam_from_world: Tensor) -> ObjectLayout:
    """Lay the objects of a photograph out on level ground.

    Args:
        found: the objects.
        camera: camera of the photograph.
        cam_from_world: rotation (3, 3).
    """
    rays = object_rays(found, camera, cam_from_world)
    rows = np.flatnonzero(rays.drops > _MIN_LEVEL_DROP)
    depth = 1 / rays.drops[rows]
    offset = depth[:, None] * rays.along[rows, :2]
    vectors = found.vectors[torch.from_numpy(rows)]
    return ObjectLayout(offset, rays.rises[rows] * depth, rays.sides[rows] * depth, vectors, rows)


class _GroundPose(NamedTuple):
    """Heading (rad), height above the ground (m) and position (east, north; m) of a camera."""

    heading: float
    height: float
    place: _Vector


class Connector:
    """Matches the objects of photographs with the landmarks of a map."""

    def __init__(
        self,
        graph: ConstellationGraph,
        landmarks: Landmarks,
        ground: GroundGrid,
        candidates: int = CANDIDATES,
    ) -> None:
        self._graph, self._landmarks, self._ground = graph, landmarks, ground
        self._candidates = candidates
        self._xy = landmarks.xyz[:, :2]
        with torch.inference_mode():
            self._described = describe_landmarks(graph, landmarks)

    @torch.inference_mode()
    def __call__(
        self,
        found: Detections,
        camera: Camera,
        base: Tensor,
        headings: Sequence[float],
        heights: Sequence[float],
    ) -> list[Candidate]:
        """Return candidate poses of a photograph, best first.

        Args:
            found: its objects.
            camera: camera of the photograph.
            base: (3, 3) ``cam_from_world`` at a heading of 0.
            headings: headings to try: counter-clockwise rotations about the vertical, rad.
            heights: heights above the ground to try, metres.
        """
        layout = lay_out(found, camera, base)
        if len(layout) < _LEAST_OBJECTS or not len(self._landmarks):
            return []
        assumed = [(heading, height) for heading in headings for height in heights]
        starts = self._vote(layout, np.array(assumed))
        refined, scores = self._refine(layout, starts)
        kept: list[tuple[float, _GroundPose]] = []
        for row in np.argsort(-scores, kind="stable").tolist():
            if all(self._is_distinct(refined[row], other) for _, other in kept):
                kept.append((float(scores[row]), refined[row]))
            if len(kept) == self._candidates:
                break
        return [Candidate(self._pose(base, each), score) for score, each in kept]

    def _is_distinct(self, one: _GroundPose, other: _GroundPose) -> bool:
        far = float(np.linalg.norm(one.place - other.place)) > _APART_M
        turn = abs(_wrap(one.heading - other.heading))
        return far or turn > _APART

    def _pose(self, base: Tensor, found: _GroundPose) -> Pose:
        rotation = base @ so3_exp(found.heading * UP)
        east, north = found.place.tolist()
        up = self._ground.height_at(east, north) + found.height
        return Pose(rotation, -rotation @ torch.tensor([east, north, up], dtype=torch.float64))

    def _match_landmarks(
        self, layout: ObjectLayout, assumed: _Vector, count: int
    ) -> tuple[_Vector, _Vector, NDArray[np.int64]]:
        """Match objects with landmarks under hypotheses (H, 2) of heading and height.

        Returns:
            Positions of the objects relative to the camera (H, N, 2), metres, and the probabilities
            and rows of the most likely landmarks of each (H, N, K), at most ``count``.
        """
        heading, height = assumed.T
        cosine, sine = np.cos(heading)[:, None], np.sin(heading)[:, None]
        x, y = layout.offset.T
        where = np.stack([cosine * x + sine * y, cosine * y - sine * x], -1)
        where = where * height[:, None, None]
        graph = self._graph
        near, there = graph.neighbours(graph.to_tensor(layout.offset))
        vectors = layout.vectors.to(near.device)
        batch = max(1, min(_BATCH, _AT_ONCE // (len(layout) * len(self._landmarks))))
        count = min(count, len(self._landmarks))
        # Allocated before the large temporary arrays, so that these leave no gaps in the heap.
        weights = np.empty((len(assumed), len(layout), count))
        rows = np.empty(weights.shape, np.int64)
        for first in range(0, len(assumed), batch):
            part = slice(first, first + batch)
            own = graph(
                vectors,
                graph.to_tensor(where[part]),
                graph.to_tensor(layout.rise * height[part, None]),
                graph.to_tensor(layout.side * height[part, None]),
                near,
                there,
            )
            # A softmax; the largest cosine, one, replaces its maximum, which saves time.
            sharpness = graph.sharpness.exp()
            likely = ((sharpness * own) @ self._described.T).sub_(sharpness).exp_()
            best, row = likely.topk(count, -1)
            weights[part] = (best / likely.sum(-1, keepdim=True)).cpu().numpy()
            rows[part] = row.cpu().numpy()
        return where, weights, rows

    def _vote(self, layout: ObjectLayout, assumed: _Vector) -> list[tuple[_GroundPose, _Matches]]:
        """Return the poses with most votes, each with the matches that voted for it."""
        where, weight, row_ = self._match_landmarks(layout, assumed, _MATCHES)
        place = self._xy[row_] - where[:, :, None]
        # Each vote is distributed bilinearly to the four cells around it.
        at = place / _CELL_M - 0.5
        corner = np.floor(at).astype(np.int64)
        number = np.arange(len(assumed))[:, None, None]
        keys, votes = [], []
        for step in ((0, 0), (0, 1), (1, 0), (1, 1)):
            cell = corner + step
            keys.append(((number * 2 * _CELLS) + cell[..., 0] + _CELLS) * 2 * _CELLS)
            keys[-1] += cell[..., 1] + _CELLS
            votes.append(weight * (1 - np.abs(at - cell)).prod(-1))
        key, cells = np.unique(np.concatenate([k.ravel() for k in keys]), return_inverse=True)
        total = np.bincount(cells, np.concatenate([v.ravel() for v in votes]))
        found = []
        for best_key in key[np.argsort(-total, kind="stable")[:_REFINED]].tolist():
            rest, north = divmod(best_key, 2 * _CELLS)
            one, east = divmod(rest, 2 * _CELLS)
            middle = (np.array([east, north]) - _CELLS + 0.5) * _CELL_M
            near = np.linalg.norm(place[one] - middle, axis=-1) < 1.5 * _CELL_M
            objects, _ = np.nonzero(near)
            matches = _Matches(objects, row_[one][near], weight[one][near])
            heading, height = assumed[one].tolist()
            found.append((_GroundPose(heading, height, middle), matches))
        return found

    def _refine(
        self, layout: ObjectLayout, starts: Sequence[tuple[_GroundPose, _Matches]]
    ) -> tuple[list[_GroundPose], _Vector]:
        """Refine poses; return them with the scores that they had before the last step."""
        poses = [self._fit(layout, start, start, matches) for start, matches in starts]
        scores = np.zeros(len(poses))
        for _ in range(_REFINEMENTS):
            assumed = np.array([(pose.heading, pose.height) for pose in poses])
            where, some, row = self._match_landmarks(layout, assumed, _CONSIDERED)
            there = np.array([pose.place for pose in poses])[:, None] + where
            squared = np.square(self._xy[row] - there[:, :, None]).sum(-1)
            weight = some * np.exp(-squared / (2 * _NEAR_M**2))
            best = weight.argmax(-1)[..., None]
            weight = np.take_along_axis(weight, best, -1)[..., 0]
            landmark = np.take_along_axis(row, best, -1)[..., 0]
            scores = weight.sum(1) / math.sqrt(len(layout))
            pulls = weight > _LEAST_WEIGHT
            poses = [
                self._fit(
                    layout,
                    starts[number][0],
                    pose,
                    _Matches(np.flatnonzero(fine), landmark[number][fine], weight[number][fine]),
                )
                for number, (pose, fine) in enumerate(zip(poses, pulls, strict=True))
            ]
        return poses, scores

    def _fit(
        self, layout: ObjectLayout, start: _GroundPose, pose: _GroundPose, matches: _Matches
    ) -> _GroundPose:
        """Return the pose that fits matches best, within bounds around the start.

        It is the least-squares similarity between the layout and its landmarks, computed with
        complex numbers.
        """
        if len(set(matches.objects.tolist())) < 3:
            return pose
        x, y = layout.offset[matches.objects].T
        own = x + 1j * y
        east, north = self._xy[matches.landmarks].T
        theirs = east + 1j * north
        weight = matches.weights / matches.weights.sum()
        middle, middle_there = (weight * own).sum(), (weight * theirs).sum()
        spread = float((weight * np.abs(own - middle) ** 2).sum())
        if spread < 1e-6:
            return pose
        turn = (weight * (theirs - middle_there) * np.conj(own - middle)).sum() / spread
        heading = start.heading + float(
            np.clip(
                _wrap(-float(np.angle(turn)) - start.heading),
                -_MOST_TURN,
                _MOST_TURN,
            )
        )
        height = float(
            np.clip(abs(turn), start.height / _MOST_STRETCH, start.height * _MOST_STRETCH)
        )
        there = middle_there - height * np.exp(-1j * heading) * middle
        return _GroundPose(heading, height, np.array([there.real, there.imag]))


class _Matches(NamedTuple):
    """K matches of objects with landmarks.

    Attributes:
        objects: (K,) rows of the objects.
        landmarks: (K,) rows of the landmarks.
        weights: (K,) positive.
    """

    objects: NDArray[np.int64]
    landmarks: NDArray[np.int64]
    weights: _Vector


def describe_landmarks(graph: ConstellationGraph, landmarks: Landmarks) -> Tensor:
    """Return unit vectors (M, D) of landmarks among their neighbours."""
    where = graph.to_tensor(landmarks.xyz[:, :2])
    near, there = graph.neighbours(where)
    described: Tensor = graph(
        graph.to_tensor(landmarks.vectors),
        where[None],
        graph.to_tensor(landmarks.rises)[None],
        graph.to_tensor(landmarks.sides)[None],
        near,
        there,
    )
    return described[0]


def _wrap(angle: float) -> float:
    """Return an angle (rad) wrapped to -pi to pi."""
    return (angle + math.pi) % math.tau - math.pi
