"""The scenes and flights that are to be published, opened and checked."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from benchmark.datasets.dataset import Dataset
from benchmark.datasets.flight import is_flight, open_flight
from benchmark.datasets.identity import sealed_sha256
from benchmark.datasets.simulated import open_scene
from benchmark.publishing.description import Release, is_invented
from benchmark.publishing.flights import flight_rows
from benchmark.publishing.index import INDEX, Provenance
from benchmark.publishing.layers import PublishedLayer
from benchmark.publishing.licenses import RENDERS_LICENSE
from benchmark.publishing.report import Sizes
from benchmark.publishing.rows import SPLITS, SceneRows
from benchmark.tracks.difficulty import Difficulty, measure
from objconnect.scene.bundle.manifest import Manifest
from objconnect.scene.bundle.scene import COVISIBILITY, FEATURES, MAP_FILES, Scene, is_scene
from objconnect.scene.config import MAX_NUMBER
from objconnect.scene.errors import InputError
from objconnect.scene.flights.origin import read_origin
from objconnect.scene.storage.files import require_distinct

OBJECTS: Final = "objects.json"
# Options that are published for a scene with withheld query poses (*sealed*). The flights cannot be
# computed from them.
_PUBLIC_OPTIONS: Final = ("size", "spp", "site")
_NO_KEY: Final = (
    "its poses do not depend on a key: 'objconnect track --sealed KEYFILE' renders scenes that can "
    "be sealed"
)


@dataclass(frozen=True)
class Source:
    """A scene or a flight to publish.

    Attributes:
        rows: its rows.
        dataset: its data set.
        provenance: how it was made.
        files: files to copy, each with its path in the published scene's folder.
    """

    rows: SceneRows
    dataset: Dataset
    provenance: Provenance
    files: tuple[tuple[str, Path], ...]

    @property
    def left_out(self) -> int:
        """Number of photographs in neither split."""
        total = sum(len(frames) for frames in self.rows.frames.values())
        return total - sum(len(self.rows.frame_rows(split)) for split in SPLITS)

    @property
    def sha256(self) -> str:
        """Digest of the published data set."""
        return sealed_sha256(self.dataset) if self.rows.sealed else self.dataset.sha256

    def difficulty(self) -> dict[str, Difficulty]:
        """Return the difficulty of each query by name.

        It is empty for a flight, for a sealed scene, and for one without depth or covisibility.
        """
        scene = self.rows.scene
        if (
            isinstance(scene, Scene)
            and not self.rows.sealed
            and (scene.path / COVISIBILITY).is_file()
            and self._has("depth")
        ):
            return {row.name: row.difficulty for row in measure(scene)}
        return {}

    def require_layers(self) -> None:
        """Refuse a scene that lacks a layer.

        Raises:
            InputError: a session has no images of a layer.
        """
        for layer in self.rows.layers:
            if not self._has(layer):
                raise InputError(
                    f"scene {self.rows.scene.path} has a session without {layer} images: leave "
                    f"out --layer {layer}"
                )

    def sizes(self) -> Sizes:
        """Return the bytes to publish.

        Raises:
            InputError: a photograph or a thermal picture is missing.
        """
        layers = 0
        for session in self.rows.frames if self.rows.layers else ():
            with self.rows.session_layers(session) as stored:
                layers += sum(stored.stored_bytes(layer) for layer in self.rows.layers)
        return Sizes(
            photographs=sum(self.rows.photograph_bytes(split) for split in SPLITS),
            maps=sum(path.stat().st_size for _, path in self.files),
            layers=layers,
        )

    def _has(self, layer: PublishedLayer) -> bool:
        """Return whether every session has a layer."""
        for session in self.rows.frames:
            with self.rows.session_layers(session) as stored:
                if not stored.has(layer):
                    return False
        return True


def open_sources(
    folders: Sequence[Path], layers: Sequence[PublishedLayer], sealed: bool
) -> list[Source]:
    """Open the scenes and flights to publish; ``sealed`` leaves out the poses of their queries.

    Raises:
        InputError: a scene or flight lacks a map, a query or a layer, has a damaged file, has the
            name of another, or cannot be sealed.
    """
    sources: list[Source] = []
    for folder in folders:
        is_flight_only = is_flight(folder) and not is_scene(folder)
        if is_flight_only and sealed:
            raise InputError(f"flight {folder} cannot be sealed, because {_NO_KEY}")
        new_sources = (
            _open_flight(folder, layers)
            if is_flight_only
            else [_open_scene(folder, layers, sealed)]
        )
        for source in new_sources:
            if source.dataset.name in (other.dataset.name for other in sources):
                raise InputError(
                    f"two scenes are called {source.dataset.name!r}: rename the folder of one"
                )
            source.require_layers()
            sources.append(source)
    return sources


def _open_scene(folder: Path, layers: Sequence[PublishedLayer], sealed: bool) -> Source:
    scene = Scene.open(folder)
    if sealed:
        _require_secret(scene)
    frames = {session: scene.frames(session) for session in scene.sessions}
    dataset = open_scene(folder)
    files = _map_files(dataset.model)
    if os.path.lexists(folder / OBJECTS):
        _ = scene.objects  # raises InputError if the list is damaged
        if not sealed:
            # The seed could be found from the exact positions of objects.
            files.append((OBJECTS, folder / OBJECTS))
    rows = SceneRows(scene, frames, layers, sealed=sealed)
    return Source(rows, dataset, _provenance(scene.manifest, sealed), tuple(files))


def _require_secret(scene: Scene) -> None:
    """Refuse to seal a scene whose poses anyone can compute, because its seed is not from a key."""
    seed = scene.manifest.seed
    if seed is None:
        raise InputError(f"scene {scene.path} cannot be sealed, because {_NO_KEY}")
    if seed <= MAX_NUMBER:
        raise InputError(
            f"scene {scene.path} cannot be sealed, because its seed can be found: render it with "
            "'objconnect track --sealed KEYFILE'"
        )


def _provenance(manifest: Manifest, sealed: bool) -> Provenance:
    """Return how a scene was made; of a sealed scene, nothing that reveals its flights."""
    config = manifest.config
    if sealed:
        config = {key: config[key] for key in _PUBLIC_OPTIONS if key in config}
    return Provenance(
        reference=manifest.reference,
        origin=manifest.origin,
        preset=manifest.preset,
        seed=None if sealed else manifest.seed,
        config=config,
        versions=manifest.versions,
    )


def _open_flight(folder: Path, layers: Sequence[PublishedLayer]) -> list[Source]:
    return [
        Source(
            flight_rows(folder, dataset, layers),
            dataset,
            Provenance(reference="stated", origin=read_origin(folder)),
            tuple(_map_files(dataset.model)),
        )
        for dataset in open_flight(folder)
    ]


def _map_files(model: Path) -> list[tuple[str, Path]]:
    """Return the files of a map, without features, because methods compute them again."""
    names = [name for name in MAP_FILES if name != FEATURES and (model / name).is_file()]
    return [(f"map/{name}", model / name) for name in names]


def find_scenes(paths: Sequence[Path]) -> list[Path]:
    """Return the given scenes and flights, and the scenes and flights in any other given folder.

    Raises:
        InputError: a path is published already, or a scene is given twice.
    """
    scenes: list[Path] = []
    for path in paths:
        scenes_inside = []
        if not _is_source(path) and path.is_dir():
            if (path / INDEX).is_file():
                raise InputError(f"{path} is published already: give the scenes, not their copy")
            scenes_inside = [folder for folder in sorted(path.iterdir()) if _is_source(folder)]
        scenes += scenes_inside or [path]
    require_distinct(scenes)
    return scenes


def _is_source(folder: Path) -> bool:
    return is_scene(folder) or is_flight(folder)


def choose_license(sources: Sequence[Source], release: Release) -> str:
    """Return the licence as an SPDX identifier.

    Raises:
        InputError: a scene may show a real site, and no licence is stated.
    """
    if release.license is not None:
        return release.license
    for source in sources:
        if not is_invented(source.provenance):
            raise InputError(
                f"{source.rows.scene.path} may show a real site: state the licence with --license"
            )
    return RENDERS_LICENSE
