"""The cameras, poses and positions that a data set states, whatever its format."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic, geodetic_from_enu
from objconnect.scene.maps.sparse_map import SparseMap

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StatedData:
    """N photographs in the order of their names, with the stated cameras, poses and positions.

    Attributes:
        subject: name or path of the data set, for people.
        kind: its format, for people.
        names: names of the photographs, sorted.
        files: where the photographs should lie; None where no folder of photographs is known.
        cameras: camera of each photograph, or None where the data set states none.
        cam_from_world: poses (N, 4, 4) in the world of the data set, or None for a table of
            positions.
        geodetic: stated latitude, longitude (degrees) and height (m), unchecked, (N, 3); None where
            the data set has no position on earth. For a data set with poses they are the camera
            centres, converted by its origin.
        measured: measured positions (N, 3) that the data set itself stores: east, north, up in
            metres in its own world, NaN for a photograph without one; None without any.
        sparse_map: points with their observations, or None.
    """

    subject: str
    kind: str
    names: tuple[str, ...]
    files: tuple[Path, ...] | None
    cameras: tuple[Camera | None, ...]
    cam_from_world: Array | None
    geodetic: Array | None = None
    measured: Array | None = None
    sparse_map: SparseMap | None = None

    def __len__(self) -> int:
        return len(self.names)

    @property
    def positions(self) -> Array | None:
        """The stated camera centres (N, 3) in the world of the data set."""
        return None if self.cam_from_world is None else centres(self.cam_from_world)


def centres(cam_from_world: Array) -> Array:
    """Return the camera centres (N, 3) of poses (N, 4, 4)."""
    rotation, translation = cam_from_world[:, :3, :3], cam_from_world[:, :3, 3]
    return np.asarray(-np.einsum("nij,ni->nj", rotation, translation))


def sample(count: int, max_rows: int, run: int) -> Sequence[int]:
    """Return rows of a sequence to examine: all, or several runs of neighbours spread over it.

    Photographs with neighbouring names were mostly taken one after another, so that they overlap.

    Args:
        count: length of the sequence.
        max_rows: maximum number of rows to return.
        run: length of a run.
    """
    if count <= max_rows:
        return range(count)
    starts = np.linspace(0, count - run, max_rows // run).astype(int)
    return sorted({int(start) + k for start in starts for k in range(run)})


def to_geodetic(positions: Array, origin: Geodetic) -> Array:
    """Return latitude, longitude (degrees) and height (m) of positions in metres, (N, 3)."""
    return np.array([geodetic_from_enu(position, origin) for position in positions]).reshape(-1, 3)
