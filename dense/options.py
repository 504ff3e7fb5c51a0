"""Options of dense reconstruction. ``dense.json`` records them beside what they made."""

from __future__ import annotations

from typing import Final

from pydantic import Field

from scene.config import Config


class SourceOptions(Config):
    """Which photographs a photograph is matched with."""

    min_common: int = Field(
        5,
        ge=1,
        description="Photographs look at the same side of things when they share this many points "
        "of the map.",
    )
    grid: int = Field(
        12, ge=1, description="The picture is covered on a grid of this many points a side."
    )
    best_angle_deg: float = Field(
        12.0, gt=0, description="Angle between the rays of two photographs that serves best."
    )
    narrower_deg: float = Field(
        5.0,
        gt=0,
        description="Width of the Gaussian weight of smaller angles, which leave depth vague.",
    )
    wider_deg: float = Field(
        15.0,
        gt=0,
        description="Width of the Gaussian weight of larger angles, which change what is seen.",
    )


class CostOptions(Config):
    """What a plane costs at a pixel."""

    sigma_px: float = Field(
        4.0, gt=0, description="Width of the Gaussian weight of pixels in the window."
    )
    sigma_grey: float = Field(
        0.1,
        gt=0,
        description="Difference in grey (0..1) over which the weight of a pixel falls by e.",
    )
    geometric_weight: float = Field(
        0.2,
        ge=0,
        description="Cost per pixel of a plane that the map of another view sends back elsewhere, "
        "...",
    )
    geometric_limit_px: float = Field(3.0, ge=0, description="... up to this distance.")


class SearchOptions(Config):
    """How the planes of a picture are sought."""

    coarsest_px: int = Field(
        160,
        ge=16,
        description="The first planes are sought in a picture with a longer side of at most this.",
    )
    first_rounds: int = Field(4, ge=1, description="Rounds of the search in that picture.")
    rounds: int = Field(1, ge=1, description="Rounds in every larger picture.")
    steepest: float = Field(
        0.5,
        ge=0,
        description="Largest slope of a guess by chance, pixels of disparity per pixel.",
    )
    step_px: float = Field(
        1.0, gt=0, description="Size of random steps, pixels of disparity; halved each round."
    )
    step_slope: float = Field(
        0.2,
        gt=0,
        description="Size of random steps of the slope, pixels of disparity per pixel; likewise.",
    )
    margin: float = Field(
        0.2,
        ge=0,
        lt=1,
        description="Guesses by chance lie this share beyond the inverse depths of the map's "
        "points.",
    )
    cost: CostOptions = Field(CostOptions(), description="What a plane costs.")


class AgreementOptions(Config):
    """When depth maps agree, and what is kept."""

    same_px: float = Field(
        1.0,
        gt=0,
        description="Two maps agree on a pixel that goes there and comes back this close, ...",
    )
    same_depth: float = Field(
        0.01, gt=0, description="... from a depth that differs by less than this share."
    )
    confirmed: int = Field(
        2, ge=1, description="A depth is kept when this many sources confirm it."
    )
    fused: int = Field(
        3, ge=1, description="A point of the cloud is kept when this many maps show it."
    )


class DenseOptions(Config):
    """How depth maps and the dense cloud are made."""

    sources: SourceOptions = Field(SourceOptions(), description="Which photographs are matched.")
    search: SearchOptions = Field(SearchOptions(), description="How planes are sought.")
    agreement: AgreementOptions = Field(
        AgreementOptions(), description="When maps agree, and what is kept."
    )


DEFAULTS: Final = DenseOptions()
"""The options unless others are asked for."""
