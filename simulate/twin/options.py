"""The configuration of a site: its files, and their metadata."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any, Final

from pydantic import Field, field_validator, model_validator

from objconnect.scene.config import Config
from objconnect.scene.storage.digests import sha256_of
from simulate.look.seasons import SEASONS

_FILES = ("ortho", "dsm", "classes")

MIN_SITE_SIDE_M: Final = 40.0
"""Minimum side of a site, metres; procedural places have 120 m or more."""


class SiteConfig(Config):
    """A real place from an orthophoto and a surface model, or from a scene with depth."""

    ortho: Path | None = Field(None, description="Orthophoto of the site, a GeoTIFF of 8 bits.")
    dsm: Path | None = Field(
        None, description="Surface model of the site, a GeoTIFF of heights, m."
    )
    scene: Path | None = Field(
        None,
        description="Scene with exact depth, or with depth of ``objconnect dense``, instead of "
        "``ortho`` and ``dsm``. The site keeps the world coordinates of the scene.",
    )
    classes: Path | None = Field(
        None,
        description="GeoTIFF of one band of 8 bits with the classes of the surface: 1 low "
        "vegetation, 4 bare or paved ground, 8 water, 16 building, 17 tree, 0 to classify "
        "automatically.",
    )
    undulation: float = Field(
        0.0,
        description="Height of the geoid above the ellipsoid, m, for heights above sea level.",
    )
    taken: datetime | None = Field(
        None,
        description="Time of the photographs, such as 2026-07-01T10:30:00Z. It gives the position "
        "of the sun, which is needed to soften the shadows of the orthophoto. None takes the time "
        "of ``scene``, and leaves the shadows of ``ortho`` as they are.",
    )
    season: str = Field("summer", description="Season that the orthophoto shows.")
    albedo: float | None = Field(
        None,
        gt=0,
        le=0.6,
        description="Mean albedo of the site, 0 to 0.6. None makes the rendering as bright as the "
        "orthophoto at noon of its season.",
    )
    max_missing_colours: float = Field(
        0.3,
        ge=0,
        lt=1,
        description="Maximum share of the area without colours, which are interpolated.",
    )
    max_missing_heights: float = Field(
        0.5,
        ge=0,
        lt=1,
        description="Maximum share of the area without heights, which are interpolated.",
    )
    sha256: dict[str, str] = Field(
        default_factory=dict,
        description="SHA-256 of the files, computed when left out. Changed files are refused.",
    )

    @model_validator(mode="before")
    @classmethod
    def _add_digests(cls, values: object) -> object:
        if not isinstance(values, dict) or values.get("sha256"):
            return values
        return values | {"sha256": file_digests(values)}

    @model_validator(mode="after")
    def _check_source(self) -> SiteConfig:
        files = self.ortho is not None and self.dsm is not None
        either = self.ortho is not None or self.dsm is not None
        if either == (self.scene is not None) or either != files:
            raise ValueError("give either an orthophoto with a surface model, or a scene")
        return self

    @field_validator("taken")
    @classmethod
    def _require_zone(cls, time: datetime | None) -> datetime | None:
        if time is not None and time.tzinfo is None:
            raise ValueError("taken needs a time zone, such as 2026-07-01T10:30:00Z")
        return time

    @field_validator("season")
    @classmethod
    def _check_season(cls, name: str) -> str:
        SEASONS.load(name)
        return name


def file_digests(values: dict[str, Any]) -> dict[str, str]:
    """Return the SHA-256 of the files of a site by field; for a scene, that of its manifest.

    Raises:
        InputError: A file cannot be read.
    """
    digests = {}
    for name in (*_FILES, "scene"):
        path = values.get(name)
        if isinstance(path, str | Path):
            file = Path(path) / "scene.json" if name == "scene" else Path(path)
            digests[name] = sha256_of(file)
    return digests
