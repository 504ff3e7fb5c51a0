"""Which object of a scene each point of its map lies on, and how many objects have one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scene.bundle.manifest import SceneObject
from scene.maps.sparse_map import MapImage


@dataclass(frozen=True)
class ObjectCoverage:
    """Objects of one kind: how many were seen, how many have a point, and their points."""

    seen: int
    with_points: int
    points: int

    def text(self) -> str:
        """For a person."""
        return (
            f"{self.with_points} of {self.seen} seen have a point "
            f"({self.with_points / self.seen:.0%}), {self.points / self.seen:.2f} points each"
        )


def coverage(
    owners: NDArray[np.int64],
    objects: Sequence[SceneObject],
    kind: Callable[[SceneObject], str],
) -> dict[str, ObjectCoverage]:
    """Objects and their points by kind.

    Args:
        owners: identifier of the object that each point lies on, (M,).
        objects: those to count.
        kind: of an object, as its size class.
    """
    points: dict[str, list[int]] = {}
    for item in objects:
        points.setdefault(kind(item), []).append(int((owners == item.id).sum()))
    return {
        name: ObjectCoverage(len(counts), sum(count > 0 for count in counts), sum(counts))
        for name, counts in sorted(points.items())
    }


def objects_of_points(
    points: int, seen: Iterable[tuple[MapImage, NDArray[np.uint16]]]
) -> NDArray[np.int64]:
    """The object that each point of a map lies on, by most of the photographs that observe it.

    Args:
        points: M of the map.
        seen: photographs of the map with their instance images (H, W).

    Returns:
        (M,) identifiers, 0 where there is none.
    """
    votes = [np.zeros((0, 2), np.int64)]
    for image, instance in seen:
        observed = image.point_rows >= 0
        columns, rows = np.floor(image.xy[observed]).astype(int).T
        # The far edges of the picture belong to its last pixels.
        ids = instance[rows.clip(0, instance.shape[0] - 1), columns.clip(0, instance.shape[1] - 1)]
        votes.append(np.stack([image.point_rows[observed], ids], -1).astype(np.int64))
    ballots, counts = np.unique(np.concatenate(votes), axis=0, return_counts=True)
    owners = np.zeros(points, np.int64)
    for row, owner in ballots[np.argsort(counts, kind="stable")]:
        owners[row] = owner
    return owners
