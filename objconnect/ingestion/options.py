"""Options of ``ingest``: photographs to match, and standard deviations of its inputs."""

from __future__ import annotations

from pydantic import Field

from objconnect.scene.config import Config


class IngestOptions(Config):
    """Options of ``ingest``, which ``scene.json`` of the scene records."""

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
        description="Standard deviation of each coordinate of a ground control point, m.",
    )
    receiver_sigma_m: float = Field(
        3.3,
        ge=0,
        description="Standard deviation to the east, and to the north, of the GPS error that all "
        "positions of a flight share, m. It is used for all photographs unless the receiver states "
        "its own for every one. The default corresponds to 8 m for 95 % of positions (GPS SPS "
        "Performance Standard, 2020).",
    )
    receiver_height_sigma_m: float = Field(
        6.6,
        ge=0,
        description="Standard deviation of the GPS error in height that all positions of a flight "
        "share, m. The default corresponds to 13 m for 95 % of positions.",
    )
    height_datum_sigma_m: float = Field(
        30.6,
        ge=0,
        description="Standard deviation of the vertical datum, m: altitudes of receivers are above "
        "sea level or above the ellipsoid. The default is the root mean square of the geoid's "
        "height over the earth. It is not used if the receiver states its own standard deviation "
        "for every photograph, or if ground control points give heights.",
    )
