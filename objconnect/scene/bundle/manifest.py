"""The JSON files of a scene: ``scene.json``, ``objects.json`` and ``splits.json``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    Field,
    FiniteFloat,
    SerializerFunctionWrapHandler,
    ValidationError,
    field_validator,
    model_serializer,
)

from objconnect.scene.bundle.georeference import EXACT, Georeference
from objconnect.scene.config import describe
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic, is_on_earth
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.files import is_safe_path, parse_json, read_text
from objconnect.scene.storage.records import Record

Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
SizeClass = Literal["small", "medium", "large"]


def _name(value: str) -> str:
    if not is_safe_path(value):
        raise ValueError("it does not lie in the scene")
    return value


def _folder(value: str) -> str:
    if value in ("", ".") or "/" in value:
        raise ValueError("a session is named like a folder")
    return _name(value)


def _condition(value: str) -> str:
    if value == ALL_CONDITIONS:
        raise ValueError(f"no condition can be called {value!r}: tables call all of them so")
    return value


ALL_CONDITIONS: Final = "all"
"""The row of result tables that takes all conditions together; no condition may have this name."""

Condition = Annotated[str, AfterValidator(_condition)]
Name = Annotated[str, AfterValidator(_name)]
FolderName = Annotated[str, AfterValidator(_folder)]


class DeclaredChange(Record):
    """The differences between a session's objects and those of other sessions, by object id.

    An id always means one box of ``objects.json``: an object that moved has another id in its new
    place.

    Attributes:
        moved: old and new id of each object that stands elsewhere.
        removed: ids of objects that are gone.
        added: ids of objects that are new.
        bare: ids of trees without leaves; their box is the same, but it is less full.
    """

    moved: tuple[tuple[int, int], ...] = ()
    removed: tuple[int, ...] = ()
    added: tuple[int, ...] = ()
    bare: tuple[int, ...] = ()


class Session(Record):
    """One flight under one condition.

    Attributes:
        condition: season and light, for example "summer-noon".
        flight: kind of flight, for example "nadir".
        role: whether the frames build the map, are queries, or are split between the two.
        change: how the objects differ from those of the scene's seed.
        readout_s: seconds between the readout of the top and the bottom row of a photograph. Where
            it is not zero (a rolling shutter), poses are those of the middle row, the camera moves
            during the readout with the central difference of its positions, and depth and the other
            layers of each row belong to the pose of that row.
    """

    condition: Condition
    flight: str
    role: Literal["map", "query", "both"]
    change: DeclaredChange = DeclaredChange()
    readout_s: FiniteFloat = 0.0


class Manifest(Record):
    """``scene.json``: what the scene is and how it was made. It is the last file to be written.

    Attributes:
        versions: versions of generator, renderer and libraries, by name.
        preset: kind of world, or None for a real flight.
        seed: random seed of the world, or None for a real flight.
        config: all other options the scene was made with.
        origin: geodetic coordinates of the world's origin.
        reference: source of the frames' poses: "exact" for rendered frames; "sfm" for structure
            from motion of all photographs together, accurate to centimetres at best.
        georeference: how exactly the origin is known on earth, as ``ingest`` measured it. None in
            scenes that do not say so, where the file has no such key; see ``on_earth``.
        sessions: sessions by folder name.
        sha256: digest of every other file of the scene, by relative path.
        pixels_sha256: by image name, digests of the decoded "image" and of each of its layers, to
            compare scenes whose files were compressed by different library versions.
    """

    schema_version: Literal[1] = 1
    versions: dict[str, str]
    preset: str | None
    seed: int | None
    config: dict[str, Any]
    origin: Geodetic
    reference: Literal["exact", "sfm"] = "exact"
    georeference: Georeference | None = None
    sessions: dict[FolderName, Session] = Field(min_length=1)
    sha256: dict[str, str]
    pixels_sha256: dict[str, dict[str, str]] = Field(default_factory=dict)

    @field_validator("origin")
    @classmethod
    def _on_earth(cls, origin: Geodetic) -> Geodetic:
        if not is_on_earth(origin):
            raise ValueError("latitude and longitude are degrees, altitude is metres")
        return origin

    @model_serializer(mode="wrap")
    def _without_unknown(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # Earlier versions refuse a key that they do not know, so it is there only where needed.
        values: dict[str, Any] = write(self)
        if self.georeference is None:
            values.pop("georeference", None)
        return values

    @property
    def on_earth(self) -> Georeference | None:
        """Return how exactly the scene is placed on earth; None if unknown.

        A world that was invented is where its origin says. The twin of a real site is where the
        files of the site are, which is not known.
        """
        if self.georeference is None and self.preset is not None and self.reference == "exact":
            return EXACT if self.config.get("site") is None else None
        return self.georeference


class SceneObject(Record):
    """One object of the world.

    Attributes:
        id: value of its pixels in the instance images.
        class_name: semantic class, for example "car".
        centre: centre of the bounding box, world metres.
        size: side lengths of the box along its own axes, metres.
        yaw_deg: rotation of the box about the vertical, counter-clockwise from east.
        size_class: class of the longest side: small under 3 m, medium under 10 m, else large.
    """

    id: int
    class_name: str
    centre: Vector
    size: Vector
    yaw_deg: float
    size_class: SizeClass


class Surroundings(Record):
    """A named part of the place, for example "urban".

    Attributes:
        name: name of the part.
        outline: polygon seen from above, (east, north) metres.
    """

    name: str
    outline: tuple[tuple[FiniteFloat, FiniteFloat], ...]

    def hold(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which points (N, 2 or more; metres) lie inside the outline, (N,) bool.

        A point is inside when a ray to the east crosses the outline an odd number of times.
        """
        start = np.array(self.outline)
        end = np.roll(start, -1, axis=0)
        step = end - start
        east, north = points[:, :1], points[:, 1:2]
        with np.errstate(divide="ignore", invalid="ignore"):
            at = start[:, 0] + (north - start[:, 1]) / step[:, 1] * step[:, 0]
        crosses = (start[:, 1] > north) != (end[:, 1] > north)
        return np.asarray((crosses & (at > east)).sum(1) % 2 == 1)


class Objects(Record):
    """``objects.json``: semantic classes, all objects, and the parts of the place.

    Attributes:
        classes: semantic label by class name.
        objects: every object of the world.
        surroundings: parts of the place; they cover it without overlap, or there are none.
    """

    classes: dict[str, int]
    objects: tuple[SceneObject, ...]
    surroundings: tuple[Surroundings, ...] = ()

    def surroundings_at(self, points: NDArray[np.float64]) -> list[str | None]:
        """Return the name of the part that each point (N, 2 or more; metres) lies in, or None."""
        names: list[str | None] = [None] * len(points)
        for part in self.surroundings:
            for k in np.flatnonzero(part.hold(points)).tolist():
                names[k] = part.name
        return names


class Splits(Record):
    """``splits.json``: which frames build the map and which are queries.

    Attributes:
        map: image names, relative to the ``sessions`` folder.
        queries: image names by session.
    """

    map: tuple[Name, ...]
    queries: dict[FolderName, tuple[Name, ...]]


def size_class(size: tuple[float, float, float]) -> SizeClass:
    """Return the size class of a box (side lengths in metres) by its longest side."""
    longest = max(size)
    if longest < 3:
        return "small"
    return "medium" if longest < 10 else "large"


F = TypeVar("F", bound=BaseModel)


def read_json(path: Path, model: type[F], what: str) -> F:
    """Read and validate a JSON file.

    Args:
        path: file to read.
        model: class of its contents.
        what: what the file is, for the message.

    Raises:
        InputError: the file is missing, not JSON, or has an unknown key or a bad value.
    """
    text = read_text(path, what)
    try:
        values = parse_json(text)
    except ValueError as error:
        raise InputError(f"{what} {path} is not valid JSON: {error}") from None
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise InputError(describe(error, model, f"in {path}")) from None


def write_json(path: Path, value: BaseModel) -> None:
    """Write a JSON file atomically.

    Raises:
        InputError: the folder cannot be written.
    """
    write_text(path, value.model_dump_json(indent=1, by_alias=True) + "\n")
