"""The JSON files of a scene: ``scene.json``, ``objects.json`` and ``splits.json``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    ValidationError,
    field_validator,
)

from scene.config import describe
from scene.errors import InputError
from scene.geometry.geodesy import Geodetic, is_on_earth
from scene.storage.files import inside, parse_json, read_text, write_text

Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
SizeClass = Literal["small", "medium", "large"]


def _name(value: str) -> str:
    if not inside(value):
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
"""How tables call all conditions of a data set together, and so the name of none."""

Condition = Annotated[str, AfterValidator(_condition)]
Name = Annotated[str, AfterValidator(_name)]
FolderName = Annotated[str, AfterValidator(_folder)]


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class DeclaredChange(_File):
    """What stands in a session that the scene's other sessions may not have, by object id.

    An id always means one box of ``objects.json``: what moved has another id in its new place.

    Attributes:
        moved: old and new id of each object that stands elsewhere.
        removed: objects that are gone.
        added: objects that are new.
        bare: trees that shed their leaves; their box stays, what fills it does not.
    """

    moved: tuple[tuple[int, int], ...] = ()
    removed: tuple[int, ...] = ()
    added: tuple[int, ...] = ()
    bare: tuple[int, ...] = ()


class Session(_File):
    """One flight under one condition.

    Attributes:
        condition: season and light, as "summer-noon".
        flight: kind of flight, as "nadir".
        role: whether its frames build the map, are localized in it, or some do one and some the
            other.
        change: how its world differs from that of the scene's seed.
        readout_s: between the readouts of the top and the bottom of its photographs. Where it is
            not zero (a rolling shutter), poses are those of the middle row, cameras move in between
            with the central difference of their positions, and depth and the other layers are of
            each row's own pose.
    """

    condition: Condition
    flight: str
    role: Literal["map", "query", "both"]
    change: DeclaredChange = DeclaredChange()
    readout_s: FiniteFloat = 0.0


class Manifest(_File):
    """``scene.json``: what the scene is and how it was made. Written last.

    Attributes:
        versions: generator, renderer and library versions by name.
        preset: kind of world, or None for a real flight.
        seed: of the world, or None for a real flight.
        config: everything else that made it.
        origin: geodetic place of the world's origin.
        reference: where the frames' poses come from: "exact" ones were rendered; those of "sfm" are
            the structure from motion of all photographs together, good to centimetres at best.
        sessions: by folder name.
        sha256: digest of every other file of the scene, by relative path.
        pixels_sha256: by image name, digests of its decoded "image" and of each of its layers, to
            compare scenes whose files were compressed by different library versions.
    """

    schema_version: Literal[1] = 1
    versions: dict[str, str]
    preset: str | None
    seed: int | None
    config: dict[str, Any]
    origin: Geodetic
    reference: Literal["exact", "sfm"] = "exact"
    sessions: dict[FolderName, Session] = Field(min_length=1)
    sha256: dict[str, str]
    pixels_sha256: dict[str, dict[str, str]] = {}

    @field_validator("origin")
    @classmethod
    def _on_earth(cls, origin: Geodetic) -> Geodetic:
        if not is_on_earth(origin):
            raise ValueError("latitude and longitude are degrees, altitude is metres")
        return origin


class SceneObject(_File):
    """One object of the world.

    Attributes:
        id: the value of its pixels in the instance images.
        class_name: as "car".
        centre: of the box, world metres.
        size: of the box along its own axes, metres.
        yaw_deg: of the box about the vertical, counter-clockwise from east.
        size_class: small under 3 m, medium under 10 m, by the longest side.
    """

    id: int
    class_name: str
    centre: Vector
    size: Vector
    yaw_deg: float
    size_class: SizeClass


class Surroundings(_File):
    """A named part of the place, as "urban": its outline seen from above, east and north metres."""

    name: str
    outline: tuple[tuple[FiniteFloat, FiniteFloat], ...]

    def hold(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the points (N, 2 or more) lie inside, counting crossings to the east."""
        start = np.array(self.outline)
        end = np.roll(start, -1, axis=0)
        step = end - start
        east, north = points[:, :1], points[:, 1:2]
        with np.errstate(divide="ignore", invalid="ignore"):
            at = start[:, 0] + (north - start[:, 1]) / step[:, 1] * step[:, 0]
        crosses = (start[:, 1] > north) != (end[:, 1] > north)
        return np.asarray((crosses & (at > east)).sum(1) % 2 == 1)


class Objects(_File):
    """``objects.json``: classes of the semantic images, every object, and the place's parts.

    Parts do not overlap and cover the place, or there are none.
    """

    classes: dict[str, int]
    objects: tuple[SceneObject, ...]
    surroundings: tuple[Surroundings, ...] = ()

    def surroundings_at(self, points: NDArray[np.float64]) -> list[str | None]:
        """The name of the part each of the points (N, 2 or more; metres) lies in, None in none."""
        names: list[str | None] = [None] * len(points)
        for part in self.surroundings:
            for k in np.flatnonzero(part.hold(points)).tolist():
                names[k] = part.name
        return names


class Splits(_File):
    """``splits.json``: which frames build the map and which are queries.

    Attributes:
        map: image names, relative to the ``sessions`` folder.
        queries: image names by session.
    """

    map: tuple[Name, ...]
    queries: dict[FolderName, tuple[Name, ...]]


def size_class(size: tuple[float, float, float]) -> SizeClass:
    """Size class of a box (metres) by its longest side."""
    longest = max(size)
    if longest < 3:
        return "small"
    return "medium" if longest < 10 else "large"


F = TypeVar("F", bound=BaseModel)


def read_json(path: Path, model: type[F], what: str) -> F:
    """Read and check a JSON file.

    Raises:
        InputError: missing, not JSON, an unknown key or a bad value.
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
