"""A scene on disk: a folder whose parts are read on demand.

``scene.json`` is written last: a folder without it is unfinished.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.covisibility import Covisibility, read_covisibility
from objconnect.scene.bundle.frames import DenseLayers, Frames, Layer, dense_layers, read_frames
from objconnect.scene.bundle.manifest import (
    Manifest,
    Objects,
    Session,
    Splits,
    read_json,
    write_json,
)
from objconnect.scene.bundle.supplement import ADDED_FEATURES, SUPPLEMENT, is_added_point
from objconnect.scene.bundle.thermal import read_thermal
from objconnect.scene.errors import InputError
from objconnect.scene.maps.colmap_files import MODEL_FILES, RIG_FILES, read_model
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.files import require_folder

MANIFEST = "scene.json"
COVISIBILITY = "covisibility.h5"
FEATURES = "features.h5"
# Files and folders that the manifest's digests cover.
_PARTS = (
    "sessions",
    "map",
    "dense",
    "objects.json",
    "splits.json",
    COVISIBILITY,
    "landmarks.h5",
    "ingest.json",
)
MAP_FILES = (*MODEL_FILES, *RIG_FILES, FEATURES, SUPPLEMENT, ADDED_FEATURES)
"""Files that this program writes into a map's folder, and that ``atomic_folder`` may replace."""


@dataclass(frozen=True)
class Scene:
    """A finished scene; its parts are read from disk on demand.

    Attributes:
        path: folder of the scene.
        manifest: contents of ``scene.json``.

    Examples:
        >>> scene = Scene.open(Path("hamlet"))  # doctest: +SKIP
        >>> for session in scene.sessions:  # doctest: +SKIP
        ...     frames = scene.frames(session)
        ...     print(session, len(frames), frames.cam_from_world.shape)
        summer-nadir 120 (120, 4, 4)
    """

    path: Path
    manifest: Manifest

    @staticmethod
    def open(path: Path) -> Scene:
        """Open a finished scene.

        Raises:
            InputError: the folder does not exist, holds no finished scene, or its manifest is
                damaged.

        Examples:
            >>> Scene.open(Path("/nowhere"))
            Traceback (most recent call last):
            objconnect.scene.errors.InputError: scene folder /nowhere does not exist: check the path
        """
        require_folder(path, "scene folder")
        if not (path / MANIFEST).is_file():
            raise InputError(
                f"{path} is not a finished scene: it has no {MANIFEST} (run simulate, ingest or "
                "map --ortho again on it to finish it)"
            )
        return Scene(path, read_json(path / MANIFEST, Manifest, "scene manifest"))

    @property
    def name(self) -> str:
        """Return the name of the folder."""
        return self.path.resolve().name

    @property
    def sessions(self) -> dict[str, Session]:
        """Return the sessions (flights) by name."""
        return self.manifest.sessions

    @property
    def images_root(self) -> Path:
        """Return the folder that image names of frames, splits and map are relative to."""
        return self.path / "sessions"

    @property
    def map_path(self) -> Path:
        """Return the folder of the COLMAP model."""
        return self.path / "map"

    @cached_property
    def splits(self) -> Splits:
        """Return the names of map frames and queries."""
        return read_json(self.path / "splits.json", Splits, "split list")

    @cached_property
    def objects(self) -> Objects:
        """Return the objects and semantic classes of the world."""
        return read_json(self.path / "objects.json", Objects, "object list")

    @cached_property
    def covisibility(self) -> Covisibility:
        """Return the covisibility of the frames of all sessions."""
        return read_covisibility(self.path / COVISIBILITY)

    def sparse_map(self) -> SparseMap:
        """Read the map.

        Raises:
            InputError: the map was not built yet, or is damaged or empty.
        """
        if not self.map_path.is_dir():
            raise InputError(f"scene {self.path} has no map yet: run 'objconnect map {self.path}'")
        return replace(read_model(self.map_path), features=self.map_path / FEATURES)

    def is_added_point(self, sparse_map: SparseMap) -> NDArray[np.bool_]:
        """Return which map points ``supplement`` added, (M,) bool.

        Raises:
            InputError: the list of added points is damaged or does not belong to this map.
        """
        return is_added_point(self.map_path, len(sparse_map.xyz))

    def check_readable(self) -> None:
        """Check before long work that the object list and the frames of all sessions can be read.

        Raises:
            InputError: the object list or the frames of a session are missing or damaged.
        """
        _ = self.objects
        for session in self.sessions:
            self.frames(session)
            with self.layers(session):
                pass

    def frames(self, session: str) -> Frames:
        """Read poses, cameras and priors of a session.

        Raises:
            InputError: the session is unknown, or its file is missing or damaged.
        """
        return read_frames(self._frames_path(session))

    def layers(self, session: str) -> AbstractContextManager[DenseLayers]:
        """Open the depth, instance, semantic and normal images of a session.

        Raises:
            InputError: the session is unknown, or its file is missing or damaged.
        """
        return dense_layers(self._frames_path(session))

    def thermal(self, name: str) -> NDArray[np.float32]:
        """Read the thermal picture of a photograph as brightness temperatures (H, W), kelvin.

        Args:
            name: image name, relative to the scene's ``sessions`` folder.

        Raises:
            InputError: the session has no such photograph or no thermal pictures, or the picture is
                missing or damaged.
        """
        session = name.partition("/")[0]
        frames = self.frames(session)
        record = self.sessions[session].thermal
        if record is None:
            raise InputError(
                f"session {session} of {self.path} has no thermal pictures: render it with "
                "thermal: true"
            )
        if name not in frames.names:
            raise InputError(f"scene {self.path} has no photograph {name}")
        camera = frames.cameras[frames.names.index(name)]
        return read_thermal(self.images_root, name, camera, record)

    def layers_of_map(
        self, sparse_map: SparseMap, *layers: Layer
    ) -> Iterator[tuple[MapImage, dict[Layer, NDArray[Any]]]]:
        """Yield the photographs of a map, each with the named layers.

        Sessions that lack one of the layers are left out.
        """
        for session in self.sessions:
            with self.layers(session) as stored:
                if not all(stored.has(layer) for layer in layers):
                    continue
                for k, name in enumerate(self.frames(session).names):
                    if name in sparse_map.images:
                        read = {layer: stored.read(layer, k) for layer in layers}
                        yield sparse_map.images[name], read

    def _frames_path(self, session: str) -> Path:
        if session not in self.sessions:
            raise InputError(
                f"scene {self.path} has no session {session!r}; it has {', '.join(self.sessions)}"
            )
        return self.images_root / session / "frames.h5"

    def find_changed_files(self) -> list[str]:
        """Return the files that were changed, removed or added since the scene was finished."""
        present = digests(self.path)
        recorded = self.manifest.sha256
        names = sorted(present.keys() | recorded.keys())
        return [name for name in names if present.get(name) != recorded.get(name)]


def finish_scene(path: Path, manifest: Manifest) -> Scene:
    """Write the manifest with the digests of all files; this marks the scene as finished.

    Raises:
        InputError: the folder cannot be written.
    """
    complete = manifest.model_copy(update={"sha256": digests(path)})
    write_json(path / MANIFEST, complete)
    return Scene(path, complete)


def digests(path: Path) -> dict[str, str]:
    """Return the SHA-256 of each file that the manifest covers, by path."""
    return {name: sha256_of(path / name) for name in _data_files(path)}


def _data_files(path: Path) -> Iterator[str]:
    for file in sorted(path.rglob("*")):
        name = file.relative_to(path).as_posix()
        hidden = any(part.startswith(".") for part in name.split("/"))
        if file.is_file() and not hidden and name.partition("/")[0] in _PARTS:
            yield name


def is_scene(path: Path) -> bool:
    """Return whether a folder is a finished scene."""
    return (path / MANIFEST).is_file()
