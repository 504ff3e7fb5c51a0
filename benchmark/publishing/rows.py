"""The rows of a published scene: its photographs with poses, cameras, priors and difficulty."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Any, Final, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from benchmark.publishing.layers import (
    LAYER_FILES,
    PublishedLayer,
    SessionLayers,
    file_size,
)
from benchmark.tracks.difficulty import Difficulty
from objconnect.scene.bundle.frames import DenseLayers, Frames
from objconnect.scene.bundle.manifest import Splits
from objconnect.scene.bundle.thermal import Thermal
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.storage.digests import sha256
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.jpeg import read_bare_jpeg

Split = Literal["map", "query"]
Row = dict[str, Any]
"""The value of each column of ``benchmark.publishing.columns``; None where it is unknown."""

SPLITS: Final[tuple[Split, ...]] = ("map", "query")

_MEASURED: Final = ("time", "gps_prior", "gps_sigma", "attitude_prior", "attitude_sigma_deg")


@dataclass(frozen=True)
class FrameRow:
    """The position of a photograph in the lists of its scene.

    Attributes:
        name: name of the photograph.
        session: the flight that took it.
        row: its row in the session's frames.
    """

    name: str
    session: str
    row: int


class SessionFacts(Protocol):
    """The properties of a session that rows contain."""

    @property
    def condition(self) -> str:
        """Season, light and weather."""
        ...

    @property
    def flight(self) -> str:
        """Kind of flight."""
        ...

    @property
    def readout_s(self) -> float:
        """Seconds between the readout of the top and the bottom row of a photograph."""
        ...

    @property
    def thermal(self) -> Thermal | None:
        """How its thermal pictures are coded; None without such pictures."""
        ...


class SceneOrFlight(Protocol):
    """A scene or a flight, the source of rows."""

    @property
    def name(self) -> str:
        """Name of its data set."""
        ...

    @property
    def path(self) -> Path:
        """Its folder."""
        ...

    @property
    def images_root(self) -> Path:
        """Folder that the names of photographs are relative to."""
        ...

    @property
    def splits(self) -> Splits:
        """Names of the map's photographs and of the queries."""
        ...

    @property
    def sessions(self) -> Mapping[str, SessionFacts]:
        """The flights by name."""
        ...

    def layers(self, session: str) -> AbstractContextManager[DenseLayers]:
        """Open the dense layers of a session."""
        ...


@dataclass(frozen=True)
class SceneRows:
    """A scene or a flight as rows.

    Attributes:
        scene: the scene or flight.
        frames: frames by session.
        layers: layers to publish.
        conditions: condition by name of the photograph, where it is not that of the session.
        difficulty: difficulty by name of the query; empty if it was not measured.
        sealed: whether rows of queries lack the pose, the time and the metadata of the photograph.
    """

    scene: SceneOrFlight
    frames: Mapping[str, Frames]
    layers: Sequence[PublishedLayer] = ()
    conditions: Mapping[str, str] = field(default_factory=dict)
    difficulty: Mapping[str, Difficulty] = field(default_factory=dict)
    sealed: bool = False

    def with_difficulty(self, difficulty: Mapping[str, Difficulty]) -> SceneRows:
        """Return the same rows with a measured difficulty."""
        return replace(self, difficulty=difficulty)

    def frame_rows(self, split: Split) -> list[FrameRow]:
        """Return the photographs of a split, in the order of the scene's list.

        Raises:
            InputError: a listed name is not a frame of the scene.
        """
        row_of = {
            name: FrameRow(name, session, row)
            for session, frames in self.frames.items()
            for row, name in enumerate(frames.names)
        }
        splits = self.scene.splits
        queries = [name for names in splits.queries.values() for name in names]
        names = splits.map if split == "map" else queries
        if unknown := [name for name in names if name not in row_of]:
            raise InputError(
                f"scene {self.scene.path}: {unknown[0]} in splits.json is not a frame: remove it "
                "from there"
            )
        return [row_of[name] for name in names]

    def session_conditions(self, session: str) -> tuple[str, ...]:
        """Return the conditions of the photographs of a session."""
        session_condition = self.scene.sessions[session].condition
        names = self.frames[session].names
        return tuple(sorted({self.conditions.get(name, session_condition) for name in names}))

    def photograph_bytes(self, split: Split) -> int:
        """Return the bytes of the photographs of a split.

        Raises:
            InputError: a photograph is missing.
        """
        images_root = self.scene.images_root
        return sum(file_size(images_root / frame.name) for frame in self.frame_rows(split))

    @contextmanager
    def session_layers(self, session: str) -> Iterator[SessionLayers]:
        """Open the layers of a session.

        Raises:
            InputError: the file of the dense layers is missing or damaged, or the rows are those of
                a flight.
        """
        scene = self.scene
        with scene.layers(session) as dense:
            yield SessionLayers(
                dense, self.frames[session], scene.images_root, scene.sessions[session].thermal
            )

    def rows(self, split: Split) -> Iterator[Row]:
        """Yield the rows of a split in order.

        Raises:
            InputError: a photograph or a layer is missing or damaged.
        """
        split_rows = self.frame_rows(split)
        for session, members in groupby(split_rows, key=lambda frame: frame.session):
            with ExitStack() as stack:
                stored = stack.enter_context(self.session_layers(session)) if self.layers else None
                for frame in members:
                    yield self._row(split, frame, stored)

    def _row(self, split: Split, frame: FrameRow, stored: SessionLayers | None) -> Row:
        frames, k = self.frames[frame.session], frame.row
        session, camera = self.scene.sessions[frame.session], frames.cameras[k]
        difficulty = self.difficulty.get(frame.name) if split == "query" else None
        layers: Row = {}
        if stored is not None:
            layers = {
                layer: _picture(
                    stored.encode(layer, k),
                    f"{frame.name}.{layer}{LAYER_FILES[layer].suffix}",
                )
                for layer in self.layers
            }
        is_sealed = self.sealed and split == "query"
        photograph = _read(self.scene.images_root / frame.name, camera, is_sealed)
        hidden: Row = {"cam_from_world": None, "time": None} if is_sealed else {}
        return {
            "name": frame.name,
            "scene": self.scene.name,
            "split": split,
            "session": frame.session,
            "condition": self.conditions.get(frame.name, session.condition),
            "flight": session.flight,
            "image": _picture(photograph, frame.name),
            "sha256": sha256(photograph),
            "camera_model": camera.model,
            "width": camera.width,
            "height": camera.height,
            "camera_params": list(camera.params),
            "cam_from_world": frames.cam_from_world[k].tolist(),
            **{key: _as_plain_value(getattr(frames, key)[k]) for key in _MEASURED},
            "overlap": None if difficulty is None else difficulty.overlap,
            "scale": None if difficulty is None else difficulty.scale,
            "angle_deg": None if difficulty is None else difficulty.angle_deg,
            "days": None if difficulty is None else difficulty.days,
            **layers,
            **hidden,
        }


def _read(path: Path, camera: Camera, without_metadata: bool) -> bytes:
    """Return the bytes of a photograph; with ``without_metadata`` without its metadata.

    Raises:
        InputError: the file is missing, damaged, or not of the camera's size.
    """
    read_rgb(path, camera)
    return read_bare_jpeg(path) if without_metadata else path.read_bytes()


def _as_plain_value(value: NDArray[np.float64]) -> Any:
    """Return a number or a list of them; None if it was not measured."""
    return None if np.isnan(value).any() else value.tolist()


def _picture(data: bytes, name: str) -> dict[str, Any]:
    return {"bytes": data, "path": name}
