"""Options of ingest: which photographs are matched, and when GPS and gimbals are believed."""

from __future__ import annotations

from pydantic import Field

from scene.colmap.options import MatchOptions
from scene.config import Config


class PairOptions(Config):
    """Which photographs are matched with each other."""

    nearest: int = Field(
        12, ge=0, description="Photographs nearest by GPS that each one is matched with."
    )
    following: int = Field(
        3, ge=0, description="Photographs taken next that each one is matched with."
    )
    blind: int = Field(
        10,
        ge=1,
        description="Photographs before and after that one without a position is matched with.",
    )


class PlacementOptions(Config):
    """How a model is placed in the world by GPS positions of which some are wrong."""

    samples: int = Field(
        500, ge=1, description="Random samples of positions that the placement is chosen from."
    )
    blunder_sigmas: float = Field(
        5.0,
        gt=0,
        description="A position further from its camera than this many standard deviations of the "
        "others is wrong, ...",
    )
    usual_error_m: float = Field(
        5.0,
        ge=0,
        description="... unless it is within this distance (m), by which receivers without "
        "corrections are always off.",
    )
    min_sigma_m: float = Field(
        0.02, gt=0, description="Standard deviations of positions are at least this (m)."
    )
    min_width: float = Field(
        0.05,
        ge=0,
        description="Least width of a flight, as a share of its length, at which its positions "
        "tell how it is rotated about its course.",
    )
    max_tilt_deg: float = Field(
        8.0,
        ge=0,
        description="Ground and cameras that agree with each other and differ by more than this "
        "from the vertical of GPS contradict its altitudes.",
    )
    ground_sigmas: float = Field(
        2.5,
        gt=0,
        description="Points further from the plane of the ground than this many standard "
        "deviations are not ground.",
    )


class DelayOptions(Config):
    """When positions are taken to be behind their photographs."""

    max_chance: float = Field(
        0.05,
        gt=0,
        lt=1,
        description="Largest share of the ways to reverse single flight lines that may explain the "
        "positions as well as the true courses do.",
    )
    enumerated_lines: int = Field(
        10,
        ge=1,
        le=20,
        description="Up to this many lines all ways are tried; of more lines, as many ways as "
        "these have are drawn at random.",
    )
    rounds: int = Field(
        3,
        ge=1,
        description="Most estimates of the delay. Each moves the centres, and with them the "
        "velocities that the next one is made from.",
    )


class AdjustmentOptions(Config):
    """What of the lenses is adjusted together with the poses."""

    min_relief: float = Field(
        0.25,
        ge=0,
        description="Focal lengths of EXIF are adjusted where depths within a picture differ by "
        "more than this share of them; over flatter ground EXIF knows them better.",
    )
    max_common_direction: float = Field(
        0.8,
        gt=0,
        le=1,
        description="Principal points are adjusted where the mean of the unit vectors to the right "
        "of a lens's cameras is shorter than this: cameras that all face one way cannot tell a "
        "principal point from a shift.",
    )
    min_gain: float = Field(
        0.002,
        ge=0,
        lt=1,
        description="Principal points leave the middle only where this lowers the reprojection "
        "error by more than this share; else errors of GPS would move them.",
    )


class IngestOptions(Config):
    """How a scene is made of photographs. The manifest of the scene records these options."""

    pairs: PairOptions = Field(PairOptions(), description="Which photographs are matched.")
    matching: MatchOptions = Field(MatchOptions(), description="Which of their features match.")
    placement: PlacementOptions = Field(
        PlacementOptions(), description="How the model is placed by GPS."
    )
    delay: DelayOptions = Field(DelayOptions(), description="When GPS is taken to be late.")
    adjustment: AdjustmentOptions = Field(
        AdjustmentOptions(), description="What of the lenses is adjusted."
    )
    guessed_focal: float = Field(
        1.2,
        gt=0,
        description="First guess of a focal length that EXIF lacks, in widths of the picture; "
        "COLMAP guesses the same.",
    )
    line_turn_deg: float = Field(
        40.0, gt=0, le=180, description="A flight line ends where the course turns by more."
    )
    max_attitude_error_deg: float = Field(
        30.0,
        gt=0,
        description="A photograph that is further off than this contradicts its gimbal, which "
        "itself is off by a few degrees, and its compass by more.",
    )
    min_attitude_sigma_deg: float = Field(
        0.1, gt=0, description="Standard deviations of attitudes are at least this."
    )
    covisibility_points: int = Field(
        200, ge=1, description="Points of each photograph on which covisibility is measured."
    )
