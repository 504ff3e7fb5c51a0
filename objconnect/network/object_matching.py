"""Objects of a photograph connected with those of a map: the poses at which they agree.

For each heading and height that may be, the photograph's objects are laid out on level ground and
described among their neighbours. Every object then votes, with the landmarks that are most like it,
for the place of the camera. The places with most votes are refined: landmarks near where an object
should lie pull heading, height and place.
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
"""Poses that a photograph's objects may have, at most."""
# Numerical guard: flatter rays meet level ground too far away.
_FLATTEST: Final = 0.35
# Likenesses of objects and landmarks computed at once, and assumptions, which bounds memory.
_AT_ONCE: Final = 8_000_000
_BATCH: Final = 28
# Cells to either side of the origin, more than any map has.
_CELLS: Final = 1 << 20
# Landmarks that an object votes with, and that it may be in the refinement, the most likely ones.
_MATCHES: Final = 6
_CONSIDERED: Final = 16
# Side of the cells of the votes, metres: what an object's place is unsure by.
_CELL_M: Final = 4.0
# Places with most votes that are refined, which bounds time, and rounds of the refinement.
_REFINED: Final = 40
_REFINEMENTS: Final = 2
# Standard deviation of a landmark's distance from where an object should lie, metres, and the
# weight of a match, 1 at most, below which it pulls nothing.
_NEAR_M: Final = 2.0
_LEAST_WEIGHT: Final = 0.05
# Candidates of the same heading are farther apart than this, and those at one place differ more.
_APART_M: Final = 8.0
_APART: Final = math.radians(17)
# How far a refined heading may be from the assumed one, and the ratio of their heights: as far as
# the next assumptions and half as far again.
_MOST_TURN: Final = math.radians(23)
_MOST_STRETCH: Final = 1.25
# A photograph with fewer objects connects with nothing: three fit anything.
_LEAST_OBJECTS: Final = 4
_Vector = NDArray[np.float64]


@dataclass(frozen=True)
class LaidOut:
    """Objects on level ground, as seen from one height above it, N of them.

    Attributes:
        offset: (N, 2) from the point below the camera, to the east and north.
        rise: (N,) heights of the centres above the ground.
        side: (N,) sides.
        vectors: (N, V) of unit length.
        rows: (N,) of the photograph's objects that these are.
    """

    offset: _Vector
    rise: _Vector
    side: _Vector
    vectors: Tensor
    rows: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.offset)


def lay_out(found: Detections, camera: Camera, cam_from_world: Tensor) -> LaidOut:
    """Lay the objects of a photograph out on level ground; lengths are in heights above it.

    Args:
        found: the objects.
        camera: of the photograph.
        cam_from_world: rotation (3, 3).
    """
    rays = object_rays(found, camera, cam_from_world)
    rows = np.flatnonzero(rays.falls > _FLATTEST)
    depth = 1 / rays.falls[rows]
    offset = depth[:, None] * rays.along[rows, :2]
    vectors = found.vectors[torch.from_numpy(rows)]
    return LaidOut(offset, rays.rises[rows] * depth, rays.sides[rows] * depth, vectors, rows)


class _Pose2(NamedTuple):
    """Heading (rad), height above the ground (m) and place (east, north; m) of a camera."""

    heading: float
    height: float
    place: _Vector


class Connector:
    """Connects photographs with the landmarks of a map.

    Args:
        graph: describes objects among their neighbours.
        landmarks: of the map.
        ground: of the map.
        candidates: poses to return at most.
    """

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
        """Return the poses at which objects of a photograph agree with the map's, best first.

        Args:
            found: the objects.
            camera: of the photograph.
            base: (3, 3) ``cam_from_world`` at a heading of 0.
            headings: to try, rad, counter-clockwise turns of the camera about the vertical.
            heights: above the ground to try, metres.
        """
        laid = lay_out(found, camera, base)
        if len(laid) < _LEAST_OBJECTS or not len(self._landmarks):
            return []
        assumed = [(heading, height) for heading in headings for height in heights]
        starts = self._vote(laid, np.array(assumed))
        refined, scores = self._refine(laid, starts)
        kept: list[tuple[float, _Pose2]] = []
        for row in np.argsort(-scores, kind="stable").tolist():
            if all(self._apart(refined[row], other) for _, other in kept):
                kept.append((float(scores[row]), refined[row]))
            if len(kept) == self._candidates:
                break
        return [Candidate(self._pose(base, each), score) for score, each in kept]

    def _apart(self, one: _Pose2, other: _Pose2) -> bool:
        far = float(np.linalg.norm(one.place - other.place)) > _APART_M
        turn = abs(_wrap(one.heading - other.heading))
        return far or turn > _APART

    def _pose(self, base: Tensor, found: _Pose2) -> Pose:
        rotation = base @ so3_exp(found.heading * UP)
        east, north = found.place.tolist()
        up = self._ground.height_at(east, north) + found.height
        return Pose(rotation, -rotation @ torch.tensor([east, north, up], dtype=torch.float64))

    def _likely(
        self, laid: LaidOut, assumed: _Vector, count: int
    ) -> tuple[_Vector, _Vector, NDArray[np.int64]]:
        """Lay objects out under assumptions (H, 2) of heading and height.

        Returns:
            Where they lie from the camera (H, N, 2), metres, and the probabilities and the rows of
            the landmarks that each most likely is (H, N, K), at most ``count``.
        """
        heading, height = assumed.T
        cosine, sine = np.cos(heading)[:, None], np.sin(heading)[:, None]
        x, y = laid.offset.T
        where = np.stack([cosine * x + sine * y, cosine * y - sine * x], -1)
        where = where * height[:, None, None]
        graph = self._graph
        near, there = graph.neighbours(graph.to_tensor(laid.offset))
        vectors = laid.vectors.to(near.device)
        batch = max(1, min(_BATCH, _AT_ONCE // (len(laid) * len(self._landmarks))))
        count = min(count, len(self._landmarks))
        # Made before what is large: kept arrays between large ones that go would hold their memory.
        weights = np.empty((len(assumed), len(laid), count))
        rows = np.empty(weights.shape, np.int64)
        for first in range(0, len(assumed), batch):
            part = slice(first, first + batch)
            own = graph(
                vectors,
                graph.to_tensor(where[part]),
                graph.to_tensor(laid.rise * height[part, None]),
                graph.to_tensor(laid.side * height[part, None]),
                near,
                there,
            )
            # A softmax, which is quicker without its maximum: no cosine is larger than one.
            sharpness = graph.sharpness.exp()
            likely = ((sharpness * own) @ self._described.T).sub_(sharpness).exp_()
            best, row = likely.topk(count, -1)
            weights[part] = (best / likely.sum(-1, keepdim=True)).cpu().numpy()
            rows[part] = row.cpu().numpy()
        return where, weights, rows

    def _vote(self, laid: LaidOut, assumed: _Vector) -> list[tuple[_Pose2, _Matches]]:
        """Return the places with most votes, each with the matches that voted for it."""
        where, weight, row_ = self._likely(laid, assumed, _MATCHES)
        place = self._xy[row_] - where[:, :, None]
        # Each vote counts in the four cells around it, by how near their middles are.
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
            found.append((_Pose2(heading, height, middle), matches))
        return found

    def _refine(
        self, laid: LaidOut, starts: Sequence[tuple[_Pose2, _Matches]]
    ) -> tuple[list[_Pose2], _Vector]:
        """Refine poses; return them with the scores that they had before the last step."""
        poses = [self._fit(laid, start, start, matches) for start, matches in starts]
        scores = np.zeros(len(poses))
        for _ in range(_REFINEMENTS):
            assumed = np.array([(pose.heading, pose.height) for pose in poses])
            where, some, row = self._likely(laid, assumed, _CONSIDERED)
            there = np.array([pose.place for pose in poses])[:, None] + where
            squared = np.square(self._xy[row] - there[:, :, None]).sum(-1)
            weight = some * np.exp(-squared / (2 * _NEAR_M**2))
            best = weight.argmax(-1)[..., None]
            weight = np.take_along_axis(weight, best, -1)[..., 0]
            landmark = np.take_along_axis(row, best, -1)[..., 0]
            scores = weight.sum(1) / math.sqrt(len(laid))
            pulls = weight > _LEAST_WEIGHT
            poses = [
                self._fit(
                    laid,
                    starts[number][0],
                    pose,
                    _Matches(np.flatnonzero(fine), landmark[number][fine], weight[number][fine]),
                )
                for number, (pose, fine) in enumerate(zip(poses, pulls, strict=True))
            ]
        return poses, scores

    def _fit(self, laid: LaidOut, start: _Pose2, pose: _Pose2, matches: _Matches) -> _Pose2:
        """Return the pose at which matches lie nearest, near what was assumed at the start.

        It is the similarity of least squares between the objects, laid out from a height of one,
        and their landmarks, in complex numbers.
        """
        if len(set(matches.objects.tolist())) < 3:
            return pose
        x, y = laid.offset[matches.objects].T
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
        return _Pose2(heading, height, np.array([there.real, there.imag]))


class _Matches(NamedTuple):
    """Objects with landmarks that are like them.

    Attributes:
        objects: (K,) rows of the objects.
        landmarks: (K,) rows of the landmarks.
        weights: (K,) positive.
    """

    objects: NDArray[np.int64]
    landmarks: NDArray[np.int64]
    weights: _Vector


def describe_landmarks(graph: ConstellationGraph, landmarks: Landmarks) -> Tensor:
    """Describe landmarks among their neighbours, (M, D) of unit length."""
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
    """Return an angle (rad) within half a turn of 0."""
    return (angle + math.pi) % math.tau - math.pi
