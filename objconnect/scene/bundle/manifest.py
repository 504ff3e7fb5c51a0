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
    model_serializer,
)

from objconnect.scene.bundle.georeference import EXACT_GEOREFERENCE, Georeference
from objconnect.scene.bundle.thermal import Thermal
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
        raise ValueError("a session must be the name of a folder, without slashes")
    return _name(value)


def _condition(value: str) -> str:
    if value == ALL_CONDITIONS:
        raise ValueError(f"no condition can be called {value!r}: it stands for all conditions")
    return value


def _place(value: Geodetic) -> Geodetic:
    if not is_on_earth(value):
        raise ValueError(
            "it is not on earth: expected latitude and longitude in degrees, altitude in metres"
        )
    return value


ALL_CONDITIONS: Final = "all"
"""Name of the row of result tables over all conditions; no condition may have it."""

Origin = Annotated[Geodetic, AfterValidator(_place)]
Condition = Annotated[str, AfterValidator(_condition)]
Name = Annotated[str, AfterValidator(_name)]
FolderName = Annotated[str, AfterValidator(_folder)]


class DeclaredChange(Record):
    """How a session differs from the world that the scene's seed generates, by object id.

    An id denotes one box of ``objects.json``: an object that moves gets a new id.

    Attributes:
        moved: old and new id of each moved object.
        removed: ids of removed objects.
        added: ids of added objects.
        bare: ids of trees without leaves, in the same boxes.
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
        role: whether the frames build the map, are queries, or both.
        change: how the objects differ from the world that the scene's seed generates.
        readout_s: seconds between the readout of the top and the bottom row of an image; not zero
            for a rolling shutter. A pose then belongs to the middle row. During the readout the
            camera moves at constant velocity, the central difference of the frames' positions. Each
            row of depth and the other layers belongs to the pose of that row.
        thermal: how thermal pictures of the same poses are coded; None without such pictures.
    """

    condition: Condition
    flight: str
    role: Literal["map", "query", "both"]
    change: DeclaredChange = DeclaredChange()
    readout_s: FiniteFloat = 0.0
    thermal: Thermal | None = None

    @model_serializer(mode="wrap")
    def _omit_missing_thermal(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # Older releases refuse unknown keys, so the key is written only if it has a value.
        values: dict[str, Any] = write(self)
        if self.thermal is None:
            values.pop("thermal", None)
        return values


class Manifest(Record):
    """``scene.json``: what the scene is and how it was made; it is written last.

    Attributes:
        versions: versions of generator, renderer and libraries, by name.
        preset: kind of site, or None for a real flight.
        seed: random seed of the world, or None for a real flight.
        config: all other options of the scene.
        origin: geodetic coordinates of the world's origin.
        reference: source of the frames' poses: "exact" for rendered frames; "sfm" for structure
            from motion of all photographs together, by ``ingest`` or by the program whose poses it
            imported, accurate to centimetres at best.
        georeference: absolute accuracy of the origin, as ``ingest`` measured or the user stated it;
            None if the file has no such key. See ``effective_georeference``.
        sessions: sessions by folder name.
        sha256: digests of the data files of the scene, including photographs, by relative path. The
            folders ``pictures`` and ``site`` and the results are not covered.
        pixels_sha256: digests of the decoded "image" and of each layer, by image name. They compare
            scenes that different library versions compressed.
    """

    schema_version: Literal[1] = 1
    versions: dict[str, str]
    preset: str | None
    seed: int | None
    config: dict[str, Any]
    origin: Origin
    reference: Literal["exact", "sfm"] = "exact"
    georeference: Georeference | None = None
    sessions: dict[FolderName, Session] = Field(min_length=1)
    sha256: dict[str, str]
    pixels_sha256: dict[str, dict[str, str]] = Field(default_factory=dict)

    @model_serializer(mode="wrap")
    def _omit_missing_georeference(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # Older releases refuse unknown keys, so the key is written only if it has a value.
        values: dict[str, Any] = write(self)
        if self.georeference is None:
            values.pop("georeference", None)
        return values

    @property
    def effective_georeference(self) -> Georeference | None:
        """Return the absolute accuracy of the scene; None if unknown.

        A simulated world is exact. A world that is modelled on a real site has the accuracy of the
        site's files, which is unknown.
        """
        if self.georeference is None and self.preset is not None and self.reference == "exact":
            return EXACT_GEOREFERENCE if self.config.get("site") is None else None
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
    """A named part of the world, for example "urban".

    Attributes:
        name: name of the part.
        outline: polygon seen from above, (east, north) metres.
    """

    name: str
    outline: tuple[tuple[FiniteFloat, FiniteFloat], ...]

    def contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which points (N, 2 or more; metres) lie inside the outline, (N,) bool."""
        start = np.array(self.outline)
        end = np.roll(start, -1, axis=0)
        step = end - start
        # A point is inside if a ray to the east crosses the outline an odd number of times.
        east, north = points[:, :1], points[:, 1:2]
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing_east = start[:, 0] + (north - start[:, 1]) / step[:, 1] * step[:, 0]
        crosses = (start[:, 1] > north) != (end[:, 1] > north)
        return np.asarray((crosses & (crossing_east > east)).sum(1) % 2 == 1)


class Objects(Record):
    """``objects.json``: semantic classes, objects and parts of the world.

    Attributes:
        classes: semantic label by class name.
        objects: every object of the seed's world and of any session.
        surroundings: parts that cover the world without overlap; empty if it has none.
    """

    classes: dict[str, int]
    objects: tuple[SceneObject, ...]
    surroundings: tuple[Surroundings, ...] = ()

    def surroundings_at(self, points: NDArray[np.float64]) -> list[str | None]:
        """Return the name of the part that each point (N, 2 or more; metres) lies in, or None."""
        names: list[str | None] = [None] * len(points)
        for part in self.surroundings:
            for k in np.flatnonzero(part.contains(points)).tolist():
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
        what: noun for the file in the message.

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
