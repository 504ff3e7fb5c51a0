"""The configuration of a real place: its files, and what is known of them."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any, Final

from pydantic import Field, field_validator, model_validator

from objconnect.scene.config import Config
from objconnect.scene.storage.digests import sha256_of
from simulate.look.conditions import SEASONS

_FILES = ("ortho", "dsm", "classes")

LEAST_SITE_M: Final = 40.0
"""Least side of a site, metres; a place that is made up has 120 m or more."""


class SiteConfig(Config):
    """A real place, given by an orthophoto and a surface model, or by a scene with depth."""

    ortho: Path | None = Field(None, description="Orthophoto of the site, a GeoTIFF of 8 bits.")
    dsm: Path | None = Field(
        None, description="Surface model of the site, a GeoTIFF of heights in metres."
    )
    scene: Path | None = Field(
        None,
        description="Scene with depth, exact or from dense, which gives both; its world becomes "
        "the twin's.",
    )
    classes: Path | None = Field(
        None,
        description="GeoTIFF of one band of 8 bits with the classes of the surface: 1 low "
        "vegetation, 4 bare or paved ground, 8 water, 16 building, 17 tree; 0 where they are to "
        "be found.",
    )
    undulation: float = Field(
        0.0,
        description="Height of the geoid above the ellipsoid, metres, for heights above sea level.",
    )
    taken: datetime | None = Field(
        None,
        description="Time of the photographs, such as 2026-07-01T10:30:00Z; it tells where the "
        "sun stood, so that shadows in the orthophoto are softened. None takes the time of the "
        "scene.",
    )
    season: str = Field("summer", description="Season that the orthophoto shows.")
    albedo: float | None = Field(
        None,
        gt=0,
        le=0.6,
        description="Mean share of the light that the site reflects. None makes the twin as "
        "bright at noon in summer as the orthophoto is.",
    )
    most_holes: float = Field(
        0.3,
        ge=0,
        lt=1,
        description="Largest share of the place that may be without colours; holes are closed.",
    )
    most_closed: float = Field(
        0.5,
        ge=0,
        lt=1,
        description="Largest share of the place that may be without heights; they are closed, too.",
    )
    sha256: dict[str, str] = Field(
        default_factory=dict,
        description="Digests of the files. They are computed when left out, so that a scene "
        "records the very site it was made of.",
    )

    @model_validator(mode="before")
    @classmethod
    def _take_digests(cls, values: object) -> object:
        if not isinstance(values, dict) or values.get("sha256"):
            return values
        return values | {"sha256": digests(values)}

    @model_validator(mode="after")
    def _one_source(self) -> SiteConfig:
        files = self.ortho is not None and self.dsm is not None
        either = self.ortho is not None or self.dsm is not None
        if either == (self.scene is not None) or either != files:
            raise ValueError("a site is either an orthophoto with a surface model, or a scene")
        return self

    @field_validator("taken")
    @classmethod
    def _has_zone(cls, time: datetime | None) -> datetime | None:
        if time is not None and time.tzinfo is None:
            raise ValueError("a time needs its zone, such as 2026-07-01T10:30:00Z")
        return time

    @field_validator("season")
    @classmethod
    def _check_season(cls, name: str) -> str:
        SEASONS.load(name)
        return name


def digests(values: dict[str, Any]) -> dict[str, str]:
    """Return the SHA-256 of the files of a site by field; that of a scene is of its manifest.

    Raises:
        InputError: A file cannot be read.
    """
    found = {}
    for name in (*_FILES, "scene"):
        path = values.get(name)
        if isinstance(path, str | Path):
            file = Path(path) / "scene.json" if name == "scene" else Path(path)
            found[name] = sha256_of(file)
    return found
