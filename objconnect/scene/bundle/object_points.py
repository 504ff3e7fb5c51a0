"""The objects on which map points lie, and the coverage of objects by points."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.manifest import SceneObject
from objconnect.scene.maps.sparse_map import MapImage


@dataclass(frozen=True)
class ObjectCoverage:
    """Counts of the objects of one kind.

    Attributes:
        seen: number of objects seen.
        with_points: number of those with at least one point.
        points: number of points on them.
    """

    seen: int
    with_points: int
    points: int

    def text(self) -> str:
        """Return the counts as one line for a person."""
        return (
            f"{self.with_points} of {self.seen} seen have a point "
            f"({self.with_points / self.seen:.0%}), {self.points / self.seen:.2f} points each"
        )


def coverage(
    owners: NDArray[np.int64],
    objects: Sequence[SceneObject],
    kind: Callable[[SceneObject], str],
) -> dict[str, ObjectCoverage]:
    """Count objects and their points by kind.

    Args:
        owners: identifier of the object that each point lies on, (M,).
        objects: objects to count.
        kind: function that returns the kind of an object, for example its size class.
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
    """Return the object that each point of a map lies on, by majority of the photographs observing
    it.

    Args:
        points: number M of points of the map.
        seen: photographs of the map, each with its instance image (H, W).

    Returns:
        Identifiers of objects, (M,); 0 for points on none.
    """
    votes = [np.zeros((0, 2), np.int64)]
    for image, instance in seen:
        observed = image.point_rows >= 0
        columns, rows = np.floor(image.xy[observed]).astype(int).T
        # A keypoint on the right or lower edge of the image belongs to the last pixel.
        ids = instance[rows.clip(0, instance.shape[0] - 1), columns.clip(0, instance.shape[1] - 1)]
        votes.append(np.stack([image.point_rows[observed], ids], -1).astype(np.int64))
    ballots, counts = np.unique(np.concatenate(votes), axis=0, return_counts=True)
    owners = np.zeros(points, np.int64)
    for row, owner in ballots[np.argsort(counts, kind="stable")]:
        owners[row] = owner
    return owners
