"""Assignment of map points to objects, and the coverage of objects by points."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.manifest import SceneObject
from objconnect.scene.maps.sparse_map import MapImage


@dataclass(frozen=True)
class ObjectCoverage:
    """Counts of the objects of one kind: objects seen, objects with a point, and points."""

    seen: int
    with_points: int
    points: int

    def text(self) -> str:
        """Return the counts as one line for the user."""
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
        owners: object identifier of each point, (M,).
        objects: objects to count.
        kind: returns the kind of an object, for example its size class.
    """
    points: dict[str, list[int]] = {}
    for item in objects:
        points.setdefault(kind(item), []).append(int((owners == item.id).sum()))
    return {
        name: ObjectCoverage(len(counts), sum(count > 0 for count in counts), sum(counts))
        for name, counts in sorted(points.items())
    }


def objects_of_points(
    points: int, photographs: Iterable[tuple[MapImage, NDArray[np.uint16]]]
) -> NDArray[np.int64]:
    """Return the object of each map point, by majority vote over the observing photographs.

    Args:
        points: number M of points of the map.
        photographs: photographs of the map, each with its instance image (H, W).

    Returns:
        Object identifiers, (M,); 0 for points on no object.
    """
    votes = [np.zeros((0, 2), np.int64)]
    for image, instance in photographs:
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
