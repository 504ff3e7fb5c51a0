"""The columns of a published data set: one row for each photograph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from benchmark.publishing.layers import LAYER_FILES, PublishedLayer

Kind = Literal["text", "float", "integer", "picture"]

ANY_LENGTH: Final = -1
"""Length of a list that may differ from row to row."""


@dataclass(frozen=True)
class Column:
    """A column of the table.

    Attributes:
        kind: type of a value; "picture" is the bytes of an image file with their name.
        meaning: description with units and frame.
        shape: lengths of nested lists of values; empty for a single value.
    """

    kind: Kind
    meaning: str
    shape: tuple[int, ...] = ()


COLUMNS: Final[Mapping[str, Column]] = {
    "name": Column("text", "name of the photograph, unique within its scene"),
    "scene": Column("text", "scene that the photograph shows"),
    "split": Column("text", "map: the map was built from it; query: its pose is to be found"),
    "session": Column("text", "flight that took the photograph, unique within its scene"),
    "condition": Column("text", "season, light and weather"),
    "flight": Column("text", "kind of the session's flight, such as nadir or oblique"),
    "image": Column(
        "picture",
        "the photograph's file, without metadata if the query's pose is withheld, else unchanged",
    ),
    "sha256": Column("text", "SHA-256 of the photograph's file"),
    "camera_model": Column("text", "COLMAP's name of the camera model"),
    "width": Column("integer", "width of the photograph, pixels"),
    "height": Column("integer", "height of the photograph, pixels"),
    "camera_params": Column("float", "parameters in COLMAP's order for the model", (ANY_LENGTH,)),
    "cam_from_world": Column(
        "float",
        "rigid transform from the world (east, north, up; metres) to the camera (x right, y down, "
        "z forward); exact in rendered scenes; null if it is withheld",
        (4, 4),
    ),
    "time": Column("float", "seconds since 1970; null if unknown or withheld"),
    "gps_prior": Column(
        "float", "camera centre measured by GNSS, world metres; null if not measured", (3,)
    ),
    "gps_sigma": Column("float", "standard deviation of gps_prior per axis, metres", (3,)),
    "attitude_prior": Column(
        "float",
        "measured rotation of cam_from_world, quaternion w x y z; null if not measured",
        (4,),
    ),
    "attitude_sigma_deg": Column("float", "standard deviation of attitude_prior, degrees"),
    "overlap": Column(
        "float",
        "of a query: share of its pixels whose surface is also visible in its best map photograph, "
        "the one that shows most of this surface; null if not measured",
    ),
    "scale": Column(
        "float",
        "of a query: ground size of its pixels relative to those of the best map photograph; null "
        "if not measured",
    ),
    "angle_deg": Column(
        "float",
        "of a query: angle between its lines of sight and those of the best map photograph, "
        "degrees; null if not measured",
    ),
    "days": Column(
        "integer",
        "of a query: days of the year between it and the best map photograph, 0 to 182; null if "
        "unknown",
    ),
}
"""The columns that every published data set has, in their order."""


def columns_with(layers: Sequence[PublishedLayer]) -> dict[str, Column]:
    """Return the columns of a data set with these layers."""
    layer_columns = {str(layer): Column("picture", LAYER_FILES[layer].meaning) for layer in layers}
    return {**COLUMNS, **layer_columns}
