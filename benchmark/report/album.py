"""The album of a data set: pictures and points that the leaderboard's page shows of every query.

``RESULTS/<dataset>/album.h5`` holds, for each query, a small photograph, the map photograph that
shows most of the same ground, and a few map points: their world coordinates, their pixels at the
reference pose, and their pixels in the map photograph. The page projects the points with the
estimated poses of the results. One album serves all methods, and no localizer reads it. It also
holds the digests of the parts of the data set, so that a later run can name what changed.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import h5py
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from benchmark.datasets.dataset import BenchmarkQuery, Dataset
from benchmark.report.pictures import project_points, thin_points
from objconnect.scene.errors import HDF5_DAMAGE, InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.files import parse_json
from objconnect.scene.storage.hdf5 import array, attribute, group, groups, set_text
from objconnect.scene.storage.hdf5_writing import hdf5_file
from objconnect.scene.storage.images import read_rgb

ALBUM: Final = "album.h5"
ALBUM_MARK: Final = b"dataset_sha256"
"""Bytes near the beginning of every album, by which an earlier album is recognized and replaced."""
# Longest side of a photograph, pixels; a page may shrink it further.
SIDE: Final = 480
_QUALITY: Final = 55
# Effort of the WebP encoder, 0 to 6. The default 4 takes over twice as long for 8 % fewer bytes.
_EFFORT: Final = 2
# Number of cells along the longest side of a photograph; a cell has one point at most.
_CELLS: Final = 6


@dataclass(frozen=True)
class Entry:
    """The album's entry of one query.

    Attributes:
        camera: camera of the query.
        photograph: photograph as WebP.
        neighbour: name of the map photograph that shows most of the same points; None where no map
            photograph shows any.
        world: (K, 3) map points that query and neighbour show, world frame, metres.
        truth: (K, 2) pixels of the points at the reference pose.
        seen: (K, 2) pixels of the points in the neighbour.
    """

    camera: Camera
    photograph: bytes
    neighbour: str | None
    world: NDArray[np.float64]
    truth: NDArray[np.float64]
    seen: NDArray[np.float64]

    def project_at(self, cam_from_world: Pose) -> NDArray[np.float64]:
        """Return the (K, 2) pixels of the points at a pose; NaN where they are not visible."""
        points = cam_from_world.transform(torch.from_numpy(self.world))
        projected = self.camera.project(points)
        return np.where(projected.valid.numpy()[:, None], projected.xy.numpy(), np.nan)


@dataclass(frozen=True)
class Neighbour:
    """A map photograph as WebP, with the size of the original in pixels."""

    width: int
    height: int
    photograph: bytes


@dataclass(frozen=True)
class Album:
    """The album of a data set.

    Attributes:
        sha256: digest of the data set that the album was made of.
        entries: entries by the name of the query.
        neighbours: map photographs by name.
        parts: digests of the parts of the data set, see ``Dataset.parts``; empty in an album of an
            older version.
    """

    sha256: str
    entries: Mapping[str, Entry]
    neighbours: Mapping[str, Neighbour]
    parts: Mapping[str, str] = field(default_factory=dict)


def make_album(dataset: Dataset, sparse_map: SparseMap) -> Album:
    """Make the album of a data set.

    Raises:
        InputError: a photograph is missing or damaged.
    """
    entries: dict[str, Entry] = {}
    neighbours: dict[str, Neighbour] = {}
    with progress_bar(f"{dataset.name} album", len(dataset.queries)) as advance:
        for query in dataset.queries:
            entry = _make_entry(query, sparse_map)
            entries[query.name] = entry
            if entry.neighbour is not None and entry.neighbour not in neighbours:
                camera = sparse_map.images[entry.neighbour].camera
                photograph = webp(read_rgb(dataset.images / entry.neighbour, camera))
                neighbours[entry.neighbour] = Neighbour(camera.width, camera.height, photograph)
            advance(len(entries))
    return Album(dataset.sha256, entries, neighbours, dataset.parts)


def _make_entry(query: BenchmarkQuery, sparse_map: SparseMap) -> Entry:
    """Choose the neighbour of a query and the points to draw."""
    truth, visible = project_points(sparse_map.xyz, query.camera, query.reference)
    shared = {
        name: _find_shared_observations(sparse_map, name, visible) for name in sparse_map.names
    }
    distance = np.linalg.norm(sparse_map.centres - query.reference.centre().numpy(), axis=1)
    row_of = {name: k for k, name in enumerate(sparse_map.names)}
    # Among photographs that share equally many points, the nearest is chosen.
    best = max(shared, key=lambda name: (len(shared[name]), -distance[row_of[name]]), default=None)
    neighbour = best if best is not None and len(shared[best]) else None
    observations = shared[neighbour] if neighbour is not None else np.zeros(0, np.int64)
    points = sparse_map.images[neighbour].point_rows[observations] if neighbour else observations
    cell = max(query.camera.width, query.camera.height) / _CELLS
    chosen = thin_points(
        truth[points], np.ones(len(points), np.bool_), sparse_map.track_length[points], cell
    )
    rows = points[chosen]
    return Entry(
        camera=query.camera,
        photograph=webp(read_rgb(query.image, query.camera)),
        neighbour=neighbour,
        world=sparse_map.xyz[rows],
        truth=truth[rows],
        seen=sparse_map.images[neighbour].xy[observations[chosen]]
        if neighbour
        else np.zeros((0, 2)),
    )


def _find_shared_observations(
    sparse_map: SparseMap, name: str, visible: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Return the rows of a map photograph's observations whose points the query sees too.

    Args:
        sparse_map: the map, of M points.
        name: name of the map photograph.
        visible: (M,) whether the query sees each point.
    """
    rows = sparse_map.images[name].point_rows
    return np.flatnonzero((rows >= 0) & visible[rows]) if len(visible) else np.zeros(0, np.int64)


def webp(rgb: NDArray[np.uint8], side: int = SIDE) -> bytes:
    """Encode a photograph (H, W, 3) as WebP whose longest side is at most ``side`` pixels."""
    image = Image.fromarray(rgb)
    image.thumbnail((side, side), Image.Resampling.LANCZOS)
    stream = io.BytesIO()
    image.save(stream, "WEBP", quality=_QUALITY, method=_EFFORT)
    return stream.getvalue()


def keep_album(path: Path, dataset: Dataset, sparse_map: SparseMap) -> None:
    """Write the album of a data set, unless the file already holds it.

    Raises:
        InputError: for the reasons of ``make_album`` and ``write_album``.
    """
    try:
        if read_album(path, dataset.sha256) is not None:
            return
    except InputError:
        pass  # a damaged album is made again
    write_album(path, make_album(dataset, sparse_map))


def write_album(path: Path, album: Album) -> None:
    """Write an album atomically.

    Raises:
        InputError: the folder cannot be written, or the disk is full.
    """
    with hdf5_file(path) as file:
        file.attrs["schema"] = 1
        set_text(file, "dataset_sha256", album.sha256)
        file["parts"] = np.frombuffer(json.dumps(album.parts).encode(), np.uint8)
        for number, (name, entry) in enumerate(album.entries.items()):
            entry_group = file.create_group(f"queries/{number:06d}")
            set_text(entry_group, "name", name)
            set_text(entry_group, "camera", str(entry.camera))
            if entry.neighbour is not None:
                set_text(entry_group, "neighbour", entry.neighbour)
            entry_group["photograph"] = np.frombuffer(entry.photograph, np.uint8)
            entry_group["world"], entry_group["truth"], entry_group["seen"] = (
                entry.world,
                entry.truth,
                entry.seen,
            )
        for number, (name, neighbour) in enumerate(album.neighbours.items()):
            neighbour_group = file.create_group(f"map/{number:06d}")
            set_text(neighbour_group, "name", name)
            neighbour_group.attrs["size"] = [neighbour.width, neighbour.height]
            neighbour_group["photograph"] = np.frombuffer(neighbour.photograph, np.uint8)


def album_parts(path: Path, sha256: str) -> dict[str, str] | None:
    """Return the digests of the parts of the data set that an album records.

    Args:
        path: file of the album.
        sha256: digest of the data set in the earlier run; the album must belong to it.

    Returns:
        The digests by part; None where the album is missing, damaged, or of other data.
    """
    try:
        with h5py.File(path, "r") as file:
            if attribute(file, "dataset_sha256") != sha256:
                return None
            return _parts(file)
    except HDF5_DAMAGE:
        return None


def _parts(file: h5py.File) -> dict[str, str]:
    parts = parse_json(array(file, "parts").tobytes().decode()) if "parts" in file else {}
    return {str(part): str(digest) for part, digest in parts.items()}


def read_album(path: Path, *digests: str) -> Album | None:
    """Read the album of a data set; None where it is missing or of other data.

    Args:
        path: the file.
        digests: accepted digests of the data set. A rendered one has several, because renders of
            different machines differ by rounding.

    Raises:
        InputError: the file is damaged.
    """
    if not path.is_file():
        return None
    try:
        with h5py.File(path, "r") as file:
            sha256 = str(attribute(file, "dataset_sha256"))
            if sha256 not in digests:
                return None
            neighbours = {
                str(attribute(item, "name")): Neighbour(
                    int(attribute(item, "size")[0]),
                    int(attribute(item, "size")[1]),
                    array(item, "photograph").tobytes(),
                )
                for _, item in (groups(group(file, "map")) if "map" in file else ())
            }
            entries = {
                str(attribute(item, "name")): Entry(
                    camera=Camera.parse(str(attribute(item, "camera")).split()),
                    photograph=array(item, "photograph").tobytes(),
                    neighbour=(
                        str(attribute(item, "neighbour")) if "neighbour" in item.attrs else None
                    ),
                    world=array(item, "world").reshape(-1, 3),
                    truth=array(item, "truth").reshape(-1, 2),
                    seen=array(item, "seen").reshape(-1, 2),
                )
                for _, item in groups(group(file, "queries"))
            }
            parts = _parts(file)
    except HDF5_DAMAGE as error:
        raise InputError(
            f"album {path} is damaged ({error}); remove it, and evaluate makes it again"
        ) from None
    if any(
        entry.neighbour is not None and entry.neighbour not in neighbours
        for entry in entries.values()
    ):
        raise InputError(f"album {path} lacks a map photograph; remove it and evaluate again")
    return Album(sha256, entries, neighbours, parts)
