"""A camera from its directions and attitudes relative to cameras whose poses are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

# Rounds of least squares, each weighing rays by the distances the last one found.
_ROUNDS = 10


@dataclass(frozen=True)
class Rays:
    """What N references say of one camera.

    Attributes:
        origins: (N, 3) centres of the references, world metres.
        directions: (N, 3) unit vectors from them to the camera.
        rotations: (N, 3, 3) ``cam_from_world`` as each reference has it.
    """

    origins: NDArray[np.float64]
    directions: NDArray[np.float64]
    rotations: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.origins)

    def __getitem__(self, rows: Sequence[int] | NDArray[np.int64]) -> Rays:
        return Rays(self.origins[rows], self.directions[rows], self.rotations[rows])

    def widest_deg(self) -> float:
        """The largest angle between two of the rays' lines, 0 to 90 degrees."""
        cosines = np.abs(self.directions @ self.directions.T).clip(max=1)
        return float(np.degrees(np.arccos(cosines.min())))

    def consensus(self, agree_deg: float, least_deg: float) -> NDArray[np.int64]:
        """Rows of the most references that agree on one camera; empty when no two do.

        Every two rays that cross at an angle propose where they meet; a reference agrees when the
        place lies in front of it along its ray and its attitude is theirs.

        Args:
            agree_deg: by how much a ray may miss the place, and an attitude another.
            least_deg: two rays that cross at less propose nothing.
        """
        best: tuple[int, float] = (1, 0.0)
        chosen = np.zeros(0, np.int64)
        for pair in combinations(range(len(self)), 2):
            two = self[list(pair)]
            if two.widest_deg() < least_deg:
                continue
            off = np.maximum(self._misses_deg(two.meet()), self._turned_deg(two.rotations[0]))
            rows = np.flatnonzero(off < agree_deg)
            score = (len(rows), -float(off[rows].sum()))
            if set(pair) <= set(rows.tolist()) and score > best:
                best, chosen = score, rows
        return chosen

    def meet(self) -> NDArray[np.float64]:
        """Where the rays meet best, (3,): least squares of the angles by which they miss it."""
        weights = np.ones(len(self))
        place = self.origins.mean(0)
        across = np.eye(3) - self.directions[:, :, None] * self.directions[:, None, :]
        for _ in range(_ROUNDS):
            weighted = weights[:, None, None] * across
            right = (weighted @ self.origins[:, :, None]).sum(0)[:, 0]
            place = np.linalg.lstsq(weighted.sum(0), right, rcond=None)[0]
            distance = np.linalg.norm(place - self.origins, axis=1)
            weights = 1 / np.maximum(distance, 1e-3 * distance.max() + 1e-12) ** 2
        return np.asarray(place)

    def attitude(self) -> NDArray[np.float64]:
        """The mean of the rotations, (3, 3)."""
        u, _, vt = np.linalg.svd(self.rotations.sum(0))
        return np.asarray(u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt)

    def _misses_deg(self, place: NDArray[np.float64]) -> NDArray[np.float64]:
        """Angle between each ray and the way from its reference to a place, (N,)."""
        way = place - self.origins
        across = np.linalg.norm(np.cross(self.directions, way), axis=1)
        return np.asarray(np.degrees(np.arctan2(across, (self.directions * way).sum(1))))

    def _turned_deg(self, rotation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Angle between each rotation and another, (N,)."""
        chord = np.linalg.norm(self.rotations - rotation, axis=(1, 2)) / np.sqrt(8)
        return np.asarray(np.degrees(2 * np.arcsin(chord.clip(max=1))))
