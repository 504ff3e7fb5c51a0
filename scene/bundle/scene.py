"""A scene on disk (DESIGN: "A scene on disk").

``scene.json`` is written last, so a folder without it is an unfinished scene.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scene.bundle.covisibility import Covisibility, read_covisibility
from scene.bundle.frames import DenseLayers, Frames, Layer, dense_layers, read_frames
from scene.bundle.manifest import Manifest, Objects, Session, Splits, read_json, write_json
from scene.bundle.supplement import ADDED_FEATURES, SUPPLEMENT, added_rows
from scene.errors import InputError
from scene.maps.colmap_files import MODEL_FILES, RIG_FILES, read_model
from scene.maps.sparse_map import MapImage, SparseMap
from scene.storage.files import sha256_of

MANIFEST = "scene.json"
COVISIBILITY = "covisibility.h5"
FEATURES = "features.h5"
MAP_FILES = (*MODEL_FILES, *RIG_FILES, FEATURES, SUPPLEMENT, ADDED_FEATURES)
"""What we write into the folder of a map, for ``folder_written_whole``."""


@dataclass(frozen=True)
class Scene:
    """A finished scene, read lazily.

    Attributes:
        path: of the folder.
        manifest: its ``scene.json``.
    """

    path: Path
    manifest: Manifest

    @staticmethod
    def open(path: Path) -> Scene:
        """Open a finished scene.

        Raises:
            InputError: no such folder, no finished scene in it, or a damaged manifest.
        """
        if not path.is_dir():
            raise InputError(f"scene folder {path} does not exist")
        if not (path / MANIFEST).is_file():
            raise InputError(
                f"{path} is not a finished scene: it has no {MANIFEST} (run simulate or ingest "
                "again on it to finish it)"
            )
        return Scene(path, read_json(path / MANIFEST, Manifest, "scene manifest"))

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.path.resolve().name

    @property
    def sessions(self) -> dict[str, Session]:
        """Flights by name."""
        return self.manifest.sessions

    @property
    def images_root(self) -> Path:
        """The folder that image names of frames, splits and map are relative to."""
        return self.path / "sessions"

    @property
    def map_path(self) -> Path:
        """The COLMAP model."""
        return self.path / "map"

    @cached_property
    def splits(self) -> Splits:
        """Map and query frames."""
        return read_json(self.path / "splits.json", Splits, "split list")

    @cached_property
    def objects(self) -> Objects:
        """Every object of the world, and the semantic classes."""
        return read_json(self.path / "objects.json", Objects, "object list")

    @cached_property
    def covisibility(self) -> Covisibility:
        """How much of each other all frames of all sessions see."""
        return read_covisibility(self.path / COVISIBILITY)

    def sparse_map(self) -> SparseMap:
        """The map.

        Raises:
            InputError: it was not built yet, or is damaged or empty.
        """
        if not self.map_path.is_dir():
            raise InputError(f"scene {self.path} has no map yet: run 'objconnect map {self.path}'")
        return read_model(self.map_path)

    def added_points(self, sparse_map: SparseMap) -> NDArray[np.bool_]:
        """Which points of the map were added to what the photographs' features made of it, (M,).

        Raises:
            InputError: the list of them is damaged or not of this map.
        """
        return added_rows(self.map_path, len(sparse_map.xyz))

    def require_lists(self) -> None:
        """Read every list of the scene, before long work that needs them at its end.

        Raises:
            InputError: one is missing or damaged.
        """
        _ = self.objects
        for session in self.sessions:
            self.frames(session)
            with self.dense(session):
                pass

    def frames(self, session: str) -> Frames:
        """Poses, cameras and priors of a session."""
        return read_frames(self._frames_path(session))

    def dense(self, session: str) -> AbstractContextManager[DenseLayers]:
        """Open the depth, instance, semantic and normal images of a session."""
        return dense_layers(self._frames_path(session))

    def mapped_layers(
        self, sparse_map: SparseMap, *layers: Layer
    ) -> Iterator[tuple[MapImage, dict[Layer, NDArray[Any]]]]:
        """The photographs of a map with layers of them, where their session has these at all."""
        for session in self.sessions:
            with self.dense(session) as dense:
                if not all(dense.has(layer) for layer in layers):
                    continue
                for k, name in enumerate(self.frames(session).names):
                    if name in sparse_map.images:
                        read = {layer: dense.read(layer, k) for layer in layers}
                        yield sparse_map.images[name], read

    def _frames_path(self, session: str) -> Path:
        if session not in self.sessions:
            raise InputError(
                f"scene {self.path} has no session {session!r}; it has {', '.join(self.sessions)}"
            )
        return self.images_root / session / "frames.h5"

    def changed_files(self) -> list[str]:
        """Files that differ from the digests of the manifest, are missing, or were added."""
        present = digests(self.path)
        recorded = self.manifest.sha256
        names = sorted(present.keys() | recorded.keys())
        return [name for name in names if present.get(name) != recorded.get(name)]


def finish(path: Path, manifest: Manifest) -> Scene:
    """Write the manifest with the digest of every file: from now on the scene is whole.

    Raises:
        InputError: the folder cannot be written.
    """
    complete = manifest.model_copy(update={"sha256": digests(path)})
    write_json(path / MANIFEST, complete)
    return Scene(path, complete)


def digests(path: Path) -> dict[str, str]:
    """SHA-256 of every file of a scene but the manifest and pictures made for people."""
    return {name: sha256_of(path / name) for name in _data_files(path)}


def _data_files(path: Path) -> Iterator[str]:
    for file in sorted(path.rglob("*")):
        name = file.relative_to(path).as_posix()
        hidden = any(part.startswith(".") for part in name.split("/"))
        if file.is_file() and not hidden and name != MANIFEST and not name.startswith("pictures/"):
            yield name
