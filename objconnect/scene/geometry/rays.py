"""The pose of a camera from directions and attitudes relative to cameras of known pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

# Iterations of reweighted least squares.
_ROUNDS = 10


@dataclass(frozen=True)
class Rays:
    """Directions to one camera and its attitudes, from N reference images.

    Attributes:
        origins: camera centres (N, 3) of the reference images, world metres.
        directions: unit vectors (N, 3) from the reference images to the camera.
        rotations: ``cam_from_world`` rotations (N, 3, 3) of the camera from each reference image.
    """

    origins: NDArray[np.float64]
    directions: NDArray[np.float64]
    rotations: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.origins)

    def __getitem__(self, rows: Sequence[int] | NDArray[np.int64]) -> Rays:
        return Rays(self.origins[rows], self.directions[rows], self.rotations[rows])

    def widest_angle_deg(self) -> float:
        """Return the largest angle between two rays as lines, 0 to 90 degrees."""
        cosines = np.abs(self.directions @ self.directions.T).clip(max=1)
        return float(np.degrees(np.arccos(cosines.min())))

    def consensus(self, max_error_deg: float, min_angle_deg: float) -> NDArray[np.int64]:
        """Return the rows of the largest set of reference images that agree on one camera pose.

        Each pair of rays proposes its intersection and the attitude of its first ray. A reference
        image agrees if its ray passes near the intersection and its attitude is near the proposed
        one. The result is empty if no two agree.

        Args:
            max_error_deg: angle between a ray and the point, and between attitudes, below which
                they agree.
            min_angle_deg: smallest angle between two rays that propose a point.
        """
        best: tuple[int, float] = (1, 0.0)
        chosen = np.zeros(0, np.int64)
        for pair in combinations(range(len(self)), 2):
            pair_rays = self[list(pair)]
            if pair_rays.widest_angle_deg() < min_angle_deg:
                continue
            errors = np.maximum(
                self._miss_angles_deg(pair_rays.intersect()),
                self._attitude_errors_deg(pair_rays.rotations[0]),
            )
            rows = np.flatnonzero(errors < max_error_deg)
            score = (len(rows), -float(errors[rows].sum()))
            if set(pair) <= set(rows.tolist()) and score > best:
                best, chosen = score, rows
        return chosen

    def intersect(self) -> NDArray[np.float64]:
        """Return the point (3,) with the least sum of squared angles to the rays."""
        weights = np.ones(len(self))
        point = self.origins.mean(0)
        # Each matrix projects onto the plane perpendicular to a ray.
        projectors = np.eye(3) - self.directions[:, :, None] * self.directions[:, None, :]
        for _ in range(_ROUNDS):
            weighted = weights[:, None, None] * projectors
            right = (weighted @ self.origins[:, :, None]).sum(0)[:, 0]
            point = np.linalg.lstsq(weighted.sum(0), right, rcond=None)[0]
            distance = np.linalg.norm(point - self.origins, axis=1)
            weights = 1 / np.maximum(distance, 1e-3 * distance.max() + 1e-12) ** 2
        return np.asarray(point)

    def attitude(self) -> NDArray[np.float64]:
        """Return the mean of the attitudes, a rotation matrix (3, 3)."""
        u, _, vt = np.linalg.svd(self.rotations.sum(0))
        return np.asarray(u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt)

    def _miss_angles_deg(self, point: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the angle (N,) between each ray and the line from its origin to a point (3,)."""
        offset = point - self.origins
        sine = np.linalg.norm(np.cross(self.directions, offset), axis=1)
        return np.asarray(np.degrees(np.arctan2(sine, (self.directions * offset).sum(1))))

    def _attitude_errors_deg(self, rotation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the angle (N,) between each attitude and a rotation (3, 3)."""
        chord = np.linalg.norm(self.rotations - rotation, axis=(1, 2)) / np.sqrt(8)
        return np.asarray(np.degrees(2 * np.arcsin(chord.clip(max=1))))
