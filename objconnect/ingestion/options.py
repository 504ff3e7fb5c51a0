"""Options of ingest: which photographs are matched, and how exact what it is told is."""

from __future__ import annotations

from pydantic import Field

from objconnect.scene.config import Config


class IngestOptions(Config):
    """The options of ingest. The manifest of the scene records these options."""

    nearest: int = Field(
        12, ge=0, description="Number of nearest photographs by GPS with which each one is matched."
    )
    following: int = Field(
        3, ge=0, description="Number of following photographs with which each one is matched."
    )
    control_sigma_m: float = Field(
        0.05,
        ge=0.001,
        le=1000,
        description="Standard deviation of a coordinate of a ground control point (m).",
    )
    receiver_sigma_m: float = Field(
        3.3,
        ge=0,
        description="Standard deviation (m) to the east, and to the north, of what all positions "
        "of a flight share, where the receiver does not state its own: 8 m for 95 % of positions "
        "(GPS SPS Performance Standard, 2020).",
    )
    receiver_height_sigma_m: float = Field(
        6.6,
        ge=0,
        description="The same of the height: 13 m for 95 % of positions.",
    )
    height_datum_sigma_m: float = Field(
        30.6,
        ge=0,
        description="Standard deviation (m) of what altitudes of receivers are above, which is the "
        "sea or the ellipsoid: the root mean square of the geoid's height over the earth. It does "
        "not count where ground control points give heights.",
    )
