"""Matching of a photograph's objects with the landmarks of a map, which gives candidate poses.

A landmark is an object of the map, with its position and size. Pairs of objects give hypotheses in
closed form (``object_pairs``). The best ones are rated by the graph: it describes the photograph's
objects among their neighbours, laid out on the ground by the hypothesis, and compares them with the
landmarks nearest to their positions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.localization.coarse.grid import GroundGrid
from objconnect.localization.coarse.search import UP, Candidate
from objconnect.network.constellation import ConstellationGraph
from objconnect.network.detector import Detections
from objconnect.network.landmarks import Landmarks, ObjectLayout, lay_out
from objconnect.network.object_pairs import Bounds, GroundPoses, ObjectSimilarity, PairSearch
from objconnect.network.object_pose import refine_pose
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose, so3_exp
from objconnect.scene.runtime.threads import map_in_threads

CANDIDATES: Final = 5
"""Default maximum number of candidate poses of a photograph."""
# Number of the most similar landmarks that an object is matched with.
_SIMILAR: Final = 24
# Hypotheses are rated in batches of at most ``_BATCH``, with at most ``_BATCH_SIMILARITIES``
# similarities, which bounds memory.
_BATCH_SIMILARITIES: Final = 4_000_000
_BATCH: Final = 8
# Maximum number of hypotheses of all attitudes that the graph rates, which bounds time.
_MAX_RATED: Final = 40
# Standard deviation of a landmark's distance from its object, metres.
_DISTANCE_SIGMA_M: Final = 2.0
# Rounds of the refinement of a candidate, and the least weight of a match in it.
_REFINEMENTS: Final = 3
_LEAST_WEIGHT: Final = 0.05
# Two candidates are distinct if their positions or their headings differ by more than this.
_DISTINCT_M: Final = 8.0
_DISTINCT_RAD: Final = math.radians(17)
# Least number of objects of a photograph, because three objects fit anywhere in a map.
_LEAST_OBJECTS: Final = 4


class _Hypotheses(NamedTuple):
    """Poses of a camera of one attitude, with their scores (H,)."""

    attitude: Tensor
    layout: ObjectLayout
    poses: GroundPoses
    scores: NDArray[np.float64]


class ObjectMatcher:
    """Matches the objects of photographs with the landmarks of a map.

    Args:
        graph: describes objects among their neighbours.
        landmarks: landmarks of the map.
        ground: heights of the map's ground.
        candidates: maximum number of candidate poses.
    """

    def __init__(
        self,
        graph: ConstellationGraph,
        landmarks: Landmarks,
        ground: GroundGrid,
        candidates: int = CANDIDATES,
    ) -> None:
        self._graph, self._ground, self._candidates = graph, ground, candidates
        self._xyz = landmarks.xyz
        self._pairs = PairSearch(landmarks, _SIMILAR) if len(landmarks) else None
        with torch.inference_mode():
            self._landmark_vectors = describe_landmarks(graph, landmarks)

    @torch.inference_mode()
    def __call__(
        self, found: Detections, camera: Camera, attitudes: Sequence[Tensor], bounds: Bounds
    ) -> list[Candidate]:
        """Return candidate poses of a photograph, best first.

        A score is the sum of two log likelihood ratios, of the objects' own vectors and of their
        vectors among neighbours, over the square root of the number of objects.

        Args:
            found: objects of the photograph.
            camera: camera of the photograph.
            attitudes: ``cam_from_world`` rotations (3, 3) to try, each with all allowed headings.
            bounds: headings (clockwise turns of the camera from an attitude, seen from above),
                heights above the ground and positions to allow.
        """
        if self._pairs is None:
            return []
        pairs, similarity = self._pairs, self._pairs.compare(found.vectors)

        def try_attitude(attitude: Tensor) -> _Hypotheses | None:
            layout = lay_out(found, camera, attitude)
            if len(layout) < _LEAST_OBJECTS:
                return None
            best = pairs(layout, similarity.select(layout.rows), bounds, _MAX_RATED)
            return _Hypotheses(attitude, layout, *best)

        tried = [each for each in map_in_threads(try_attitude, attitudes) if each is not None]
        if not tried:
            return []
        least = np.sort(np.concatenate([each.scores for each in tried]))[-_MAX_RATED:][:1]
        rated = [self._rate(each, least) for each in tried]
        found_poses = [pose for each in rated for pose in self._to_candidates(each)]
        kept = self._select_distinct(sorted(found_poses, key=lambda each: -each[0].score))
        if len(attitudes) == 1:
            return kept
        return [self._refine(each, found, camera, similarity) for each in kept]

    def _rate(self, tried: _Hypotheses, least: NDArray[np.float64]) -> _Hypotheses:
        """Return the hypotheses whose score is at least ``least``.

        The log-likelihood ratios of the graph network are added to their scores. Cosines times
        the sharpness of the graph network (its logit scale) are log likelihoods.
        """
        rows = np.flatnonzero(tried.scores >= least)
        layout, poses, scores = tried.layout, tried.poses.select(rows), tried.scores[rows]
        assert self._pairs is not None
        graph, sharpness = self._graph, self._graph.sharpness.exp()
        near, exists = graph.neighbours(graph.to_tensor(layout.offset))
        vectors = layout.vectors.to(near.device)
        offset = layout.offset[:, 0] + 1j * layout.offset[:, 1]
        batch = max(
            1, min(_BATCH, _BATCH_SIMILARITIES // (len(layout) * len(self._landmark_vectors)))
        )
        for first in range(0, len(rows), batch):
            part = poses.select(np.arange(first, min(first + batch, len(rows))))
            positions, height = (
                part.scaled_rotation[:, None] * offset,
                np.abs(part.scaled_rotation)[:, None],
            )
            described = graph(
                vectors,
                graph.to_tensor(np.stack([positions.real, positions.imag], -1)),
                graph.to_tensor(layout.rise * height),
                graph.to_tensor(layout.side * height),
                near,
                exists,
            )
            landmarks, weights = self._pairs.matches(offset, part, _DISTANCE_SIGMA_M)
            same = (described * self._landmark_vectors[torch.from_numpy(landmarks)]).sum(
                -1
            ) * sharpness
            any_ = (described @ self._landmark_vectors.T * sharpness).logsumexp(-1)
            ratio = (same - any_ + math.log(len(self._landmark_vectors))).clamp_min(0).cpu().numpy()
            scores[first : first + batch] += (ratio * weights).sum(1) / math.sqrt(len(layout))
        return tried._replace(poses=poses, scores=scores)

    def _to_candidates(self, tried: _Hypotheses) -> list[tuple[Candidate, float]]:
        """Return the hypotheses as candidates, each with its heading."""
        candidates = []
        for scaled_rotation, position, score in zip(*tried.poses, tried.scores, strict=True):
            heading, height = -float(np.angle(scaled_rotation)), float(abs(scaled_rotation))
            rotation = tried.attitude @ so3_exp(heading * UP)
            up = self._ground.height_at(position.real, position.imag) + height
            centre = torch.tensor([position.real, position.imag, up], dtype=torch.float64)
            pose = Pose(rotation, -rotation @ centre)
            candidates.append((Candidate(pose, float(score)), heading))
        return candidates

    def _refine(
        self, candidate: Candidate, found: Detections, camera: Camera, similarity: ObjectSimilarity
    ) -> Candidate:
        """Return a candidate with its pose, including the tilt, refined by its matches."""
        assert self._pairs is not None
        pose = candidate.pose
        directions, _ = camera.unproject(found.xy.double())
        rays = (directions[:, :2] / directions[:, 2:]).numpy()
        for _ in range(_REFINEMENTS):
            layout = lay_out(found, camera, pose.rotation)
            east, north, up = pose.centre().tolist()
            height = up - self._ground.height_at(east, north)
            ground = GroundPoses(np.array([height + 0j]), np.array([complex(east, north)]))
            offset = layout.offset[:, 0] + 1j * layout.offset[:, 1]
            rows, weights = (
                each[0] for each in self._pairs.matches(offset, ground, _DISTANCE_SIGMA_M)
            )
            weights = weights * (weights > _LEAST_WEIGHT) * similarity.ratio[layout.rows, rows]
            pose = refine_pose(pose, rays[layout.rows], self._xyz[rows], weights)
        return replace(candidate, pose=pose)

    def _select_distinct(self, ranked: Sequence[tuple[Candidate, float]]) -> list[Candidate]:
        """Return the first candidates that differ in position or heading."""
        kept: list[tuple[Candidate, float]] = []
        for one, heading in ranked:
            if all(_differs(one, heading, *each) for each in kept):
                kept.append((one, heading))
                if len(kept) == self._candidates:
                    break
        return [one for one, _ in kept]


def _differs(one: Candidate, heading: float, other: Candidate, other_heading: float) -> bool:
    """Return whether two candidates differ in position or heading."""
    distance = (one.pose.centre() - other.pose.centre())[:2].norm()
    turn = abs((heading - other_heading + math.pi) % math.tau - math.pi)
    return float(distance) > _DISTINCT_M or turn > _DISTINCT_RAD


def describe_landmarks(graph: ConstellationGraph, landmarks: Landmarks) -> Tensor:
    """Return unit vectors (M, D) of landmarks among their neighbours."""
    xy = graph.to_tensor(landmarks.xyz[:, :2])
    near, exists = graph.neighbours(xy)
    vectors: Tensor = graph(
        graph.to_tensor(landmarks.vectors),
        xy[None],
        graph.to_tensor(landmarks.rises)[None],
        graph.to_tensor(landmarks.sides)[None],
        near,
        exists,
    )
    return vectors[0]
