"""Reader of published folders, on this machine or on the Hugging Face hub.

It needs neither the scenes that were published nor Blender.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.datasets.dataset import Dataset, Task
from benchmark.datasets.identity import parts_of
from benchmark.datasets.simulated import query_of
from benchmark.publishing.index import INDEX, PublishedScene, read_index, scene_folder
from benchmark.publishing.photographs import unpack_photographs
from benchmark.publishing.rows import SPLITS, Row
from benchmark.publishing.shards import read_shards
from objconnect.scene.bundle.frames import FRAME_SHAPES, Frames, check_arrays
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.storage.digests import digests_in
from objconnect.scene.storage.hub import download, is_address

# Preview pictures are not downloaded, because no method reads them.
_NOT_READ: Final = ("pictures/*",)
_CAMERA: Final = ("camera_model", "width", "height", "camera_params")
QUERY_COLUMNS: Final = ("name", "session", "condition", "sha256", *_CAMERA, *FRAME_SHAPES)
"""The columns from which a query is made."""
_IDENTITY: Final = np.eye(4).tolist()


class PublishedReader:
    """Reads published folders; see ``benchmark.datasets.open.Reader``."""

    name = "published"
    holds = f"{INDEX} (a published data set)"

    def recognizes(self, path: Path) -> bool:
        """Return whether a path is a published folder or the address of one on the hub."""
        return is_address(path) or (path / INDEX).is_file()

    def open(self, path: Path) -> list[Dataset]:
        """Open every scene of a published folder.

        Raises:
            InputError: a file is missing, damaged or was changed, the address cannot be read, or
                the poses of the queries are withheld.
        """
        folder = _folder(path)
        published = read_index(folder)
        if published.sealed:
            raise InputError(
                f"the query poses of {path} are withheld, so it cannot be scored here: 'objconnect "
                "submit' writes the poses of a method, and the organiser scores them"
            )
        return [_open(folder, scene) for scene in published.scenes]


READER: Final = PublishedReader()


def is_sealed(path: Path) -> bool:
    """Return whether a path is a published folder whose query poses are withheld.

    Raises:
        InputError: the list of scenes is damaged, or the address cannot be read.
    """
    return READER.recognizes(path) and read_index(_folder(path)).sealed


def open_sealed(path: Path) -> list[Task]:
    """Open every scene of a published folder whose query poses are withheld.

    Raises:
        InputError: a file is missing, damaged or was changed, or the address cannot be read.
    """
    folder = _folder(path)
    datasets = [_open(folder, scene, sealed=True) for scene in read_index(folder).scenes]
    return [_drop_references(dataset) for dataset in datasets]


def _folder(path: Path) -> Path:
    return download(path, "dataset", exclude=_NOT_READ) if is_address(path) else path


def _drop_references(dataset: Dataset) -> Task:
    queries = tuple(query.without_reference() for query in dataset.queries)
    parts = parts_of(dataset.model, dataset.images, dataset.load_map().names, queries)
    return Task(
        name=dataset.name,
        track=dataset.track,
        parts=parts,
        map_conditions=dataset.map_conditions,
        model=dataset.model,
        load_map=dataset.load_map,
        images=dataset.images,
        queries=queries,
    )


def _open(folder: Path, scene: PublishedScene, sealed: bool = False) -> Dataset:
    """Open one scene of a published folder; the poses of sealed queries are the identity."""
    _require_intact(folder, scene)
    shards = {split: [folder / name for name in scene.shards.get(split, ())] for split in SPLITS}
    query_rows = list(read_shards(shards["query"], QUERY_COLUMNS))
    if not query_rows:
        raise InputError(f"{folder}: scene {scene.name} has no query")
    if sealed:
        query_rows = [row | {"cam_from_world": _IDENTITY} for row in query_rows]
    map_rows = read_shards(shards["map"], ("name", "sha256"))
    sha256_of = {row["name"]: row["sha256"] for row in (*map_rows, *query_rows)}
    images = unpack_photographs([*shards["map"], *shards["query"]], sha256_of)
    frames = frames_of(folder, query_rows)
    queries = []
    for k, row in enumerate(query_rows):
        session = scene.sessions.get(row["session"])
        if session is None or row["condition"] not in session.conditions:
            raise InputError(
                f"{folder / INDEX}: query {row['name']} belongs to no session: download the data "
                "set again"
            )
        image = images / row["name"]
        queries.append(query_of(frames, k, image, row["session"], row["condition"], str(folder)))
    model = folder / scene_folder(scene.name) / "map"
    sparse_map = read_model(model)
    return Dataset(
        name=scene.name,
        track=scene.track,
        parts=parts_of(model, images, sparse_map.names, queries),
        map_conditions=scene.map_conditions,
        model=model,
        load_map=lambda: sparse_map,
        images=images,
        queries=tuple(queries),
        unjudged=scene.unjudged,
    )


def _require_intact(folder: Path, scene: PublishedScene) -> None:
    """Refuse a folder whose files are not those that were published."""
    present = digests_in(folder, scene.files, "missing")
    for name, published in scene.files.items():
        if present[name] == "missing":
            raise InputError(f"{folder / name} does not exist: download the data set again")
        if present[name] != published:
            raise InputError(
                f"{folder / name} is not the file that was published: download it again"
            )
    shard_names = {name for names in scene.shards.values() for name in names}
    if unlisted := sorted(shard_names - scene.files.keys()):
        raise InputError(
            f"{folder / INDEX}: shard {unlisted[0]} has no digest: download the data set again"
        )


def frames_of(folder: Path, rows: Sequence[Row]) -> Frames:
    """Return rows as frames, checked like those of a scene.

    Args:
        folder: the published folder, for messages.
        rows: rows with the columns of ``QUERY_COLUMNS``.

    Raises:
        InputError: a name is missing or listed twice, or a camera or an array is wrong.
    """
    names = tuple(row["name"] for row in rows)
    for name, count in Counter(names).items():
        if not name:
            raise InputError(f"{folder}: a photograph has no name")
        if count > 1:
            raise InputError(f"{folder}: photograph {name!r} is listed {count} times")
    try:
        arrays = {key: _array(rows, key, shape) for key, shape in FRAME_SHAPES.items()}
    except (ValueError, TypeError) as error:
        raise InputError(f"{folder}: a pose or a prior has a wrong shape: {error}") from None
    check_arrays(folder, names, arrays)
    return Frames(names, tuple(_camera(folder, row) for row in rows), **arrays)


def _array(rows: Sequence[Row], key: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return a column as an array (N, *shape), with NaN for unknown values."""
    array = np.full((len(rows), *shape), np.nan)
    for k, row in enumerate(rows):
        if row[key] is not None:
            array[k] = row[key]
    return array


def _camera(folder: Path, row: Row) -> Camera:
    model, width, height, params = (row[key] for key in _CAMERA)
    try:
        return Camera(model, width, height, tuple(params))
    except (InputError, TypeError) as error:
        raise InputError(f"{folder}: camera of {row['name']}: {error}") from None
