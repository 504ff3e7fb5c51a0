"""Hypotheses of a camera's pose from pairs of objects and pairs of landmarks, in closed form.

A landmark is an object of the map, with its position and size. On level ground, two objects of a
photograph and the two landmarks that they are matched with give the heading, the height and the
position of the camera. A hypothesis is scored by all objects, each by its distance from the nearest
landmark and their similarity, so that few of the matches need be right. Nothing is sampled at
random.
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

from objconnect.network.landmarks import Landmarks, ObjectLayout
from objconnect.network.nearest_landmarks import NearestLandmarks

_Complex = NDArray[np.complex128]
_Real = NDArray[np.float64]
# Sharpness of the softmax over cosines of vectors.
_SHARPNESS: Final = 10.0
# Maximum number of landmarks of a tile of the map: an object is matched in each tile.
_MAX_TILE_LANDMARKS: Final = 800
# Maximum number of partners of an object, and of matched pairs of all objects, which bounds time.
_MAX_PARTNERS: Final = 6
_MAX_PAIRS: Final = 1_000_000
# Least distance of two partners, in units of the camera's height. Nearer ones give no exact
# heading.
_MIN_BASELINE: Final = 0.12
# Largest difference of the logarithms of two heights of the camera: the one from a pair of
# matches and the one from the sizes of their objects.
_SIZE_TOLERANCE: Final = 0.35
# Largest ratio of a height, and largest difference of a heading (rad), to the nearest one allowed.
_MAX_HEIGHT_RATIO: Final = 1.2
_MAX_HEADING_DIFFERENCE: Final = math.radians(15)
# Standard deviation of a landmark's distance from its object, metres: of hypotheses, and of poses
# in the refinement.
_DISTANCE_SIGMA_M: Final = 1.5
_REFINED_SIGMA_M: Final = 2.0
_ROUNDS: Final = 2
# Largest change in one round of the refinement: heading (rad) and logarithm of the height.
_MOST_CHANGE: Final = 0.3
# Maximum number of objects by which hypotheses are compared, which bounds time.
_MAX_SCORED: Final = 128
# Number of the best hypotheses, among which distinct ones are chosen.
_BEST: Final = 4000
# Two hypotheses are distinct if their positions or their headings differ by more than this.
_DISTINCT_M: Final = 4.0
_DISTINCT_RAD: Final = 0.2


class GroundPoses(NamedTuple):
    """H poses above level ground, as similarity transforms of the complex plane.

    An object at ``offset`` from the camera lies at ``position + scaled_rotation * offset``.

    The real axis points to the east, the imaginary one to the north.

    Attributes:
        scaled_rotation: (H,) height above the ground, metres, times ``exp(-i * heading)``. The
            heading is clockwise from the heading for which the objects were laid out.
        position: (H,) position of the camera, metres.
    """

    scaled_rotation: _Complex
    position: _Complex

    def select(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> GroundPoses:
        """Return the poses with these rows."""
        return GroundPoses(self.scaled_rotation[rows], self.position[rows])

    def transform(self, offset: _Complex) -> _Complex:
        """Return the positions (H, N) of objects at offsets (N,) from the camera."""
        positions: _Complex = self.position[:, None] + self.scaled_rotation[:, None] * offset
        return positions


@dataclass(frozen=True)
class Bounds:
    """Poses that are allowed.

    Attributes:
        headings: radians, as in ``GroundPoses``; headings near one of these are allowed.
        heights: metres; heights near or between these are allowed.
        region: centre (east, north) and radius, metres; None for everywhere.
    """

    headings: Sequence[float]
    heights: Sequence[float]
    region: tuple[float, float, float] | None = None

    def allow(self, poses: GroundPoses) -> NDArray[np.bool_]:
        """Return whether each pose is allowed (H,)."""
        height = np.abs(poses.scaled_rotation)
        allowed = height > min(self.heights) / _MAX_HEIGHT_RATIO
        allowed &= height < max(self.heights) * _MAX_HEIGHT_RATIO
        if 2 * _MAX_HEADING_DIFFERENCE * len(self.headings) < math.tau:
            difference = poses.scaled_rotation[:, None] * np.exp(1j * np.array(self.headings))
            allowed &= (np.abs(np.angle(difference)) < _MAX_HEADING_DIFFERENCE).any(1)
        if self.region is not None:
            east, north, radius = self.region
            allowed &= np.abs(poses.position - complex(east, north)) <= radius
        return allowed


class ObjectSimilarity(NamedTuple):
    """The similarity of N objects and M landmarks.

    Attributes:
        ratio: (N, M) log-likelihood ratio of an object being this landmark rather than a random
            one; negative values are 0.
        rows: (T, N, K) rows of the most similar landmarks of each tile of the map.
    """

    ratio: NDArray[np.float32]
    rows: NDArray[np.int64]

    def select(self, rows: NDArray[np.int64]) -> ObjectSimilarity:
        """Return the similarity of the objects with these rows."""
        return ObjectSimilarity(self.ratio[rows], self.rows[:, rows])

    def most_distinctive(self, count: int) -> NDArray[np.int64]:
        """Return the rows of the objects with the largest ratios, at most ``count``."""
        return np.sort(np.argsort(-self.ratio.max(1), kind="stable")[:count])


class PairSearch:
    """Finds the poses at which the objects of a photograph lie on landmarks of a map.

    Args:
        landmarks: the landmarks, at least one.
        similar: number of the most similar landmarks of a tile that an object is matched with.
    """

    def __init__(self, landmarks: Landmarks, similar: int) -> None:
        self._positions: _Complex = landmarks.xyz[:, 0] + 1j * landmarks.xyz[:, 1]
        self._log_sides = np.log(np.maximum(landmarks.sides.astype(np.float64), 0.1))
        self._vectors = torch.nn.functional.normalize(torch.from_numpy(landmarks.vectors), dim=1)
        self._tiles = _tiles(landmarks.xyz[:, :2], np.arange(len(landmarks)))
        self._similar = min(similar, *map(len, self._tiles))
        self._nearest = NearestLandmarks(self._positions)

    def compare(self, vectors: Tensor) -> ObjectSimilarity:
        """Return the similarity of objects with unit vectors (N, V) and the landmarks."""
        cosine = vectors.float() @ self._vectors.T
        rows = [tile[cosine[:, tile].topk(self._similar).indices.numpy()] for tile in self._tiles]
        ratio = _SHARPNESS * cosine
        chance = ratio.logsumexp(1, keepdim=True) - math.log(ratio.shape[1])
        return ObjectSimilarity((ratio - chance).clamp_min(0).numpy(), np.stack(rows))

    def __call__(
        self, layout: ObjectLayout, similarity: ObjectSimilarity, bounds: Bounds, count: int
    ) -> tuple[GroundPoses, _Real]:
        """Return the best distinct poses, at most ``count``, and their scores.

        A score is the sum of the log likelihood ratios of the matched objects over the square root
        of the number of objects.
        """
        offset: _Complex = layout.offset[:, 0] + 1j * layout.offset[:, 1]
        poses = self._hypotheses(layout, offset, similarity)
        poses = poses.select(bounds.allow(poses))
        rows = similarity.most_distinctive(_MAX_SCORED)
        scores = self._scores(offset[rows], similarity.select(rows), poses)
        kept = poses.select(_select_distinct(poses, scores, count))
        for _ in range(_ROUNDS):
            kept = self._refine(offset, similarity, kept)
        kept = kept.select(bounds.allow(kept))
        return kept, self._scores(offset, similarity, kept)

    def matches(
        self, offset: _Complex, poses: GroundPoses, sigma_m: float = _DISTANCE_SIGMA_M
    ) -> tuple[NDArray[np.int64], _Real]:
        """Return the landmark nearest to each object (H, N), and the weight (H, N) of the match.

        The weight is a Gaussian of the distance, 1 at the object, with a sigma of ``sigma_m``.
        """
        positions = poses.transform(offset)
        rows, is_inside = self._nearest(positions)
        distance = np.abs(self._positions[rows] - positions)
        return rows, np.exp(-np.square(distance / sigma_m) / 2) * is_inside

    def _hypotheses(
        self, layout: ObjectLayout, offset: _Complex, similarity: ObjectSimilarity
    ) -> GroundPoses:
        """Return the poses that pairs of matches give, if the sizes of the objects agree."""
        one, other = _pairs(offset, similarity.rows.shape[2])
        baseline = (offset[other] - offset[one])[:, None, None]
        sides = np.log(np.maximum(layout.side, 1e-9))[:, None]
        scaled_rotations, camera_positions = [], []
        for rows in similarity.rows:
            first, second = self._positions[rows[one]], self._positions[rows[other]]
            scaled_rotation = (second[:, None, :] - first[:, :, None]) / baseline
            # Half the logarithm of the height at which an object has the size of a landmark, for
            # each match. The sum over a pair is the logarithm of the height by both sizes.
            by_size = (self._log_sides[rows] - sides) / 2
            expected = by_size[one][:, :, None] + by_size[other][:, None, :]
            height = np.log(np.maximum(np.abs(scaled_rotation), 1e-9))
            pair, row, _ = agree = np.nonzero(np.abs(height - expected) < _SIZE_TOLERANCE)
            scaled_rotations.append(scaled_rotation[agree])
            camera_positions.append(first[pair, row] - scaled_rotation[agree] * offset[one[pair]])
        return GroundPoses(np.concatenate(scaled_rotations), np.concatenate(camera_positions))

    def _scores(self, offset: _Complex, similarity: ObjectSimilarity, poses: GroundPoses) -> _Real:
        sums = self._nearest.sum_near(similarity.ratio, offset, *poses, sigma_m=_DISTANCE_SIGMA_M)
        return sums / math.sqrt(max(1, len(offset)))

    def _refine(
        self, offset: _Complex, similarity: ObjectSimilarity, poses: GroundPoses
    ) -> GroundPoses:
        """Return the least-squares similarity transforms from objects to landmarks near them."""
        rows, weights = self.matches(offset, poses, _REFINED_SIGMA_M)
        weight = similarity.ratio[np.arange(len(offset)), rows] * weights
        weight /= np.maximum(weight.sum(1, keepdims=True), 1e-12)
        landmarks = self._positions[rows]
        middle, landmark_middle = (weight * offset).sum(1), (weight * landmarks).sum(1)
        centred = offset - middle[:, None]
        variance = (weight * np.square(np.abs(centred))).sum(1)
        scaled_rotation = (weight * (landmarks - landmark_middle[:, None]) * centred.conj()).sum(1)
        scaled_rotation /= np.maximum(variance, 1e-9)
        change = np.log(
            np.where(scaled_rotation == 0, 1e-9, scaled_rotation) / poses.scaled_rotation
        )
        small = (np.abs(change.real) < _MOST_CHANGE) & (np.abs(change.imag) < _MOST_CHANGE)
        position = landmark_middle - scaled_rotation * middle
        return GroundPoses(
            np.where(small, scaled_rotation, poses.scaled_rotation),
            np.where(small, position, poses.position),
        )


def _tiles(xy: _Real, rows: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return rows of positions (M, 2) in tiles of nearly equal numbers, split at medians."""
    if len(rows) <= _MAX_TILE_LANDMARKS:
        return [rows]
    axis = int(np.ptp(xy[rows], axis=0).argmax())
    order = rows[np.argsort(xy[rows, axis], kind="stable")]
    half = len(order) // 2
    return _tiles(xy, order[:half]) + _tiles(xy, order[half:])


def _pairs(offset: _Complex, similar: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows of pairs: each object with its nearest partners beyond ``_MIN_BASELINE``."""
    count = len(offset)
    most = _MAX_PAIRS // (count * similar**2)
    partners = min(count - 1, max(1, min(_MAX_PARTNERS, most)))
    distance = np.abs(offset[:, None] - offset)
    distance[distance < _MIN_BASELINE] = np.inf
    nearest = np.argsort(distance, axis=1, kind="stable")[:, :partners]
    one, other = np.repeat(np.arange(count), partners), nearest.ravel()
    exists = np.isfinite(distance[one, other])
    pairs = np.sort(np.column_stack([one, other])[exists], axis=1)
    one, other = np.unique(pairs, axis=0).T
    return one, other


def _select_distinct(poses: GroundPoses, scores: _Real, count: int) -> NDArray[np.int64]:
    """Return the rows of the best poses that differ, best first."""
    remaining = np.argsort(-scores, kind="stable")[:_BEST]
    kept: list[int] = []
    while len(remaining) and len(kept) < count:
        best = int(remaining[0])
        kept.append(best)
        is_far = np.abs(poses.position[remaining] - poses.position[best]) > _DISTINCT_M
        is_rotated = (
            np.abs(np.angle(poses.scaled_rotation[remaining] / poses.scaled_rotation[best]))
            > _DISTINCT_RAD
        )
        remaining = remaining[is_far | is_rotated]
    return np.array(kept, np.int64)
