"""Options of the map supplement: detection, tracking and triangulation of small objects."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from objconnect.scene.config import Config


class BlobOptions(Config):
    """Options of the detection of blobs that may show small objects."""

    surround_ratio: float = Field(
        2.5, gt=1, description="Radius of the surroundings a blob is compared with, in its own."
    )
    colour_sigma_px: float = Field(
        0.7, gt=0, description="Blur (px) before the colour of a blob is read."
    )
    min_contrast: float = Field(
        5.0, gt=0, description="Least difference from the surroundings (CIE L*a*b*)."
    )
    max_count: int = Field(12000, ge=1, description="Most blobs of a photograph.")
    border_px: int = Field(8, ge=1, description="Pixels at the edge in which no blob counts.")


class GroundOptions(Config):
    """Estimate of the ground under a map from its points."""

    neighbours: int = Field(
        24,
        ge=3,
        description="The ground under a point is a plane through this many points around it, seen "
        "from above.",
    )
    close_m: tuple[Annotated[float, Field(gt=0)], ...] = Field(
        (0.8, 0.4, 0.2, 0.1, 0.1, 0.1),
        min_length=1,
        description="Scales of Cauchy's weights (m) in the rounds in which the plane is fitted. "
        "The plane begins level at the median of the points.",
    )
    cell_m: float = Field(2.0, gt=0, description="Side of the cells of the ground (m).")
    margin_m: float = Field(
        15.0, ge=0, description="Margin of the ground around the middle 99 % of the points (m)."
    )
    ray_steps: int = Field(
        6, ge=1, description="Iterations of the intersection of rays with the ground."
    )


class TrackOptions(Config):
    """Options of the tracking of blobs over several photographs."""

    lowest_m: float = Field(-0.75, description="Lowest height above the ground that is tried.")
    highest_m: float = Field(3.3, description="Heights above the ground are tried below this.")
    height_step_m: float = Field(0.25, gt=0, description="Step between heights that are tried.")
    max_photographs: int = Field(
        24, ge=1, description="Most photographs that each photograph is compared with."
    )
    min_overlap: float = Field(
        0.05, ge=0, le=1, description="Least share of the same ground that they must show."
    )
    max_offset_px: float = Field(
        1.3, gt=0, description="Largest distance of a blob from the projection of a place."
    )
    min_cosine: float = Field(
        0.75, ge=-1, le=1, description="Least cosine of the appearances of two blobs."
    )
    min_strength_ratio: float = Field(
        0.4, ge=0, le=1, description="Least ratio of the weaker to the stronger blob's contrast."
    )
    max_colour_difference: float = Field(
        15.0, gt=0, description="Largest difference of the blobs' colours (CIE L*a*b*)."
    )
    max_error_px: float = Field(
        1.5, gt=0, description="Observations with a larger reprojection error leave a place."
    )
    iterations: int = Field(4, ge=2, description="Gauss-Newton steps that refine the places.")
    settling: int = Field(
        2, ge=0, description="Iterations of the refinement before outliers are dropped."
    )
    border_px: float = Field(
        4.0, ge=0, description="Pixels at the edge in which a place does not count as visible."
    )
    min_free_share: float = Field(
        0.7,
        ge=0,
        le=1,
        description="Least share of its blobs that no better place has taken, for a place to stay.",
    )


class PhotoconsistencyOptions(Config):
    """Options of the comparison of colours around a place between photographs."""

    radius_px: int = Field(2, ge=1, description="Radius of the window that is compared.")
    distance_scale: float = Field(
        6.0, gt=0, description="Weights of pixels fall by e over this squared distance (px^2)."
    )
    colour_scale: float = Field(
        8.0,
        gt=0,
        description="Weights of pixels fall by e over this difference from the middle's colour "
        "(CIE L*a*b*).",
    )
    max_difference: float = Field(
        15.0, gt=0, description="Colour difference from which on a pixel does not match at all."
    )
    blur_px: float = Field(0.5, gt=0, description="Blur (px) of the photographs beforehand.")


class SupplementConfig(Config):
    """Thresholds of association and triangulation."""

    neighbours: int = Field(
        12,
        ge=1,
        description="Photographs that each is compared with: those that share most map points.",
    )
    epipolar_px: float = Field(
        2.0,
        gt=0,
        description="Two detections may be of one object when each lies closer than this to the "
        "other's epipolar line.",
    )
    similarity: float = Field(
        0.8, ge=-1, le=1, description="Least cosine of their descriptors for that."
    )
    reprojection_px: float = Field(
        2.0, gt=0, description="A detection belongs to a point that projects this close to it."
    )
    views: int = Field(3, ge=2, description="Photographs that must agree on a point.")
    angle_deg: float = Field(
        3.0, gt=0, lt=90, description="Least angle between two of the rays that made a point."
    )
    above_m: float = Field(
        0.1, gt=0, description="Least height of a place above the ground around it."
    )
    below_m: float = Field(
        3.2, gt=0, description="Largest height of a place above the ground around it."
    )
    likely: float = Field(
        0.8, gt=0, lt=1, description="Least probability of being on an object, by the classifier."
    )
    apart_m: float = Field(
        0.5, ge=0, description="Least distance of a place from the map's own points."
    )
    blobs: BlobOptions = Field(BlobOptions(), description="Which blobs of a photograph count.")
    ground: GroundOptions = Field(
        GroundOptions(), description="Estimate of the ground under the map."
    )
    tracks: TrackOptions = Field(
        TrackOptions(), description="When blobs of several photographs are one place."
    )
    photoconsistency: PhotoconsistencyOptions = Field(
        PhotoconsistencyOptions(), description="How colours around a place are compared."
    )
