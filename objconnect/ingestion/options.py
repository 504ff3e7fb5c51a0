"""Options of ingest: which photographs are matched, and when GPS and gimbals are believed."""

from __future__ import annotations

from pydantic import Field

from objconnect.scene.colmap.options import MatchOptions
from objconnect.scene.config import Config


class PairOptions(Config):
    """The choice of photographs that are matched with each other."""

    nearest: int = Field(
        12, ge=0, description="Number of nearest photographs by GPS with which each one is matched."
    )
    following: int = Field(
        3, ge=0, description="Number of following photographs with which each one is matched."
    )
    blind: int = Field(
        10,
        ge=1,
        description="Number of photographs before and after with which one without a position is "
        "matched.",
    )


class PlacementOptions(Config):
    """The placement of a model in the world by GPS positions, some of which are wrong."""

    samples: int = Field(
        500,
        ge=1,
        description="Number of random samples of positions from which the placement is chosen.",
    )
    blunder_sigmas: float = Field(
        5.0,
        gt=0,
        description="A position is wrong if it is further from its camera than this many standard "
        "deviations of the others, and further than usual_error_m.",
    )
    usual_error_m: float = Field(
        5.0,
        ge=0,
        description="Usual error (m) of receivers without corrections. Positions within it are not "
        "wrong.",
    )
    min_sigma_m: float = Field(
        0.02, gt=0, description="Standard deviations of positions are at least this (m)."
    )
    min_width: float = Field(
        0.05,
        ge=0,
        description="Least width of a flight, as a share of its length, at which its positions "
        "determine the rotation about its course.",
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
    """The detection of positions that are late relative to their photographs."""

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
        description="Up to this many lines, all ways are tried. For more lines, the same number of "
        "ways is drawn at random.",
    )
    rounds: int = Field(
        3,
        ge=1,
        description="Largest number of iterations of the delay. Each changes the centres, and so "
        "the velocities from which the next one is computed.",
    )


class AdjustmentOptions(Config):
    """The parameters of the lenses that are adjusted together with the poses."""

    min_relief: float = Field(
        0.25,
        ge=0,
        description="Focal lengths of EXIF are adjusted where depths within a picture differ by "
        "more than this share. Over flatter ground, EXIF is better than an estimate.",
    )
    max_common_direction: float = Field(
        0.8,
        gt=0,
        le=1,
        description="Principal points are adjusted where the mean of the unit vectors to the right "
        "of a lens's cameras is shorter than this. If all cameras face one way, a principal point "
        "cannot be distinguished from a shift.",
    )
    min_gain: float = Field(
        0.002,
        ge=0,
        lt=1,
        description="Principal points are refined only where this reduces the reprojection error "
        "by more than this share. Otherwise errors of GPS would move them.",
    )


class ControlOptions(Config):
    """The surveyed points that a model is adjusted to."""

    sigma_m: float = Field(
        0.05,
        ge=0.001,
        le=1000,
        description="Standard deviation of a surveyed coordinate (m).",
    )
    wrong_m: float = Field(
        1.0,
        ge=0,
        description="A point is wrong if it is further than this (m), and than blunder_sigmas of "
        "the placement, from where the others put it.",
    )


class GeoreferenceOptions(Config):
    """What no photograph tells of how exactly a scene is placed on earth."""

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


class IngestOptions(Config):
    """The options of ingest. The manifest of the scene records these options."""

    pairs: PairOptions = Field(PairOptions(), description="Which photographs are matched.")
    matching: MatchOptions = Field(MatchOptions(), description="Which of their features match.")
    placement: PlacementOptions = Field(
        PlacementOptions(), description="Placement of the model by GPS."
    )
    delay: DelayOptions = Field(DelayOptions(), description="Detection of late GPS.")
    adjustment: AdjustmentOptions = Field(
        AdjustmentOptions(), description="Parameters of the lenses that are adjusted."
    )
    control: ControlOptions = Field(ControlOptions(), description="Ground control points.")
    georeference: GeoreferenceOptions = Field(
        GeoreferenceOptions(), description="How exactly the scene is placed on earth."
    )
    guessed_focal: float = Field(
        1.2,
        gt=0,
        description="First guess of a focal length that EXIF lacks, in longest sides of the "
        "picture; COLMAP guesses the same.",
    )
    line_turn_deg: float = Field(
        40.0, gt=0, le=180, description="A flight line ends where the course turns by more."
    )
    max_attitude_error_deg: float = Field(
        30.0,
        gt=0,
        description="A photograph contradicts its gimbal if their attitudes differ by more than "
        "this. Usual errors of gimbals are a few degrees, and those of compasses are larger.",
    )
    min_attitude_sigma_deg: float = Field(
        0.1, gt=0, description="Standard deviations of attitudes are at least this."
    )
    covisibility_points: int = Field(
        200,
        ge=1,
        description="Number of points of each photograph by which covisibility is measured.",
    )
