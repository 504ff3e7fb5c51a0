"""``published.json``: the scenes of a published folder and the digests of their files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, Field

from benchmark.publishing.layers import PublishedLayer
from objconnect.scene.bundle.manifest import Condition, FolderName, Name, read_json
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.storage.names import is_utf8
from objconnect.scene.storage.records import Record

INDEX: Final = "published.json"

_Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


def _require_utf8(value: str) -> str:
    if not is_utf8(value):
        raise ValueError("it is not UTF-8")
    return value


class PublishedSession(Record):
    """One flight of a published scene; see ``objconnect.scene.bundle.manifest.Session``.

    Attributes:
        conditions: conditions of its photographs.
        flight: kind of flight.
        readout_s: seconds between the readout of the top and the bottom row of a photograph.
    """

    conditions: tuple[Condition, ...]
    flight: str
    readout_s: float


class Provenance(Record):
    """How a scene was made.

    Attributes:
        reference: source of the poses: "exact" if rendered, "sfm" if from structure from motion, or
            "stated" if from the files of a flight.
        origin: geodetic coordinates of the world's origin; None if unknown.
        preset: kind of site; None for a real one and for a flight.
        seed: random seed of the site; None for a real one and for a flight.
        config: options that the scene was made with.
        versions: versions of the programs that made it.
    """

    reference: Literal["exact", "sfm", "stated"]
    origin: Geodetic | None
    preset: str | None = None
    seed: int | None = None
    config: dict[str, Any] = Field(default_factory=dict)
    versions: dict[str, str] = Field(default_factory=dict)


class PublishedScene(Provenance):
    """A scene or flight of a published folder.

    Attributes:
        name: name of the scene and of its data set.
        track: kind of its data set, see ``benchmark.datasets.dataset.Dataset``.
        sha256: digest of its data set.
        map_conditions: conditions of the map's photographs.
        unjudged: thresholds for which its reference poses are too inexact.
        sessions: flights by name.
        photographs: number of photographs by split.
        left_out: number of photographs in neither split, which are not published.
        shards: files of the rows by split, in order.
        files: SHA-256 of each file of the scene by its path in the folder, shards included.
    """

    name: Annotated[FolderName, AfterValidator(_require_utf8)]
    track: str
    sha256: _Digest
    map_conditions: tuple[Condition, ...]
    unjudged: tuple[str, ...] = ()
    sessions: dict[FolderName, PublishedSession]
    photographs: dict[Literal["map", "query"], int]
    left_out: int
    shards: dict[Literal["map", "query"], tuple[Name, ...]]
    files: dict[Name, _Digest]


class PublishedIndex(Record):
    """The contents of ``published.json``.

    Attributes:
        license: SPDX identifier.
        layers: layers that the rows contain.
        scenes: the scenes.
        sealed: whether the poses of the queries are left out; then ``sha256`` of a scene is the
            digest of this public half.
    """

    schema_version: Literal[1] = 1
    license: str
    layers: tuple[PublishedLayer, ...]
    scenes: tuple[PublishedScene, ...] = Field(min_length=1)
    sealed: bool = False

    @property
    def files(self) -> dict[str, str]:
        """Return the SHA-256 of each file of the scenes by its path in the folder."""
        return {path: sha256 for scene in self.scenes for path, sha256 in scene.files.items()}


def read_index(folder: Path) -> PublishedIndex:
    """Read ``published.json``.

    Raises:
        InputError: the file is missing, not JSON, or has an unknown key or a bad value.
    """
    return read_json(folder / INDEX, PublishedIndex, "list of published scenes")


def scene_folder(scene: str) -> str:
    """Return the path of a scene's map and objects in the published folder."""
    return f"scenes/{scene}"
