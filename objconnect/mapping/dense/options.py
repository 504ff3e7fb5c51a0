"""Options of dense reconstruction. ``dense.json`` records them beside what they made."""

from __future__ import annotations

from typing import Final

from pydantic import Field

from objconnect.scene.config import Config


class SourceOptions(Config):
    """Which photographs a photograph is matched with."""

    min_common: int = Field(
        5,
        ge=1,
        description="Photographs with at least this many common points of the map see the same "
        "surfaces.",
    )
    grid: int = Field(
        12, ge=1, description="Sources must cover the points of a grid of this many points a side."
    )
    best_angle_deg: float = Field(
        12.0, gt=0, description="Best angle between the rays of two photographs."
    )
    narrower_deg: float = Field(
        5.0,
        gt=0,
        description="Width of the Gaussian weight of smaller angles, which make the depth inexact.",
    )
    wider_deg: float = Field(
        15.0,
        gt=0,
        description="Width of the Gaussian weight of larger angles, which change the appearance.",
    )


class CostOptions(Config):
    """The cost of a plane at a pixel."""

    sigma_px: float = Field(
        4.0, gt=0, description="Width of the Gaussian weight of pixels in the window."
    )
    sigma_grey: float = Field(
        0.1,
        gt=0,
        description="Difference in grey (0..1) at which the weight of a pixel falls by "
        "the factor e.",
    )
    geometric_weight: float = Field(
        0.2,
        ge=0,
        description="Additional cost per pixel of distance after a round trip through the map of "
        "another view.",
    )
    geometric_limit_px: float = Field(
        3.0, ge=0, description="Largest distance of this round trip (px) that counts."
    )


class SearchOptions(Config):
    """The search for the planes of a picture."""

    coarsest_px: int = Field(
        160,
        ge=16,
        description="Largest long side of the smallest picture of the search (px).",
    )
    first_rounds: int = Field(4, ge=1, description="Rounds of the search in the smallest picture.")
    rounds: int = Field(1, ge=1, description="Rounds in every larger picture.")
    steepest: float = Field(
        0.5,
        ge=0,
        description="Largest slope of a random first guess, pixels of disparity per pixel.",
    )
    step_px: float = Field(
        1.0, gt=0, description="Size of random steps, pixels of disparity; halved each round."
    )
    step_slope: float = Field(
        0.2,
        gt=0,
        description="Size of random steps of the slope, pixels of disparity per pixel; halved each "
        "round.",
    )
    margin: float = Field(
        0.2,
        ge=0,
        lt=1,
        description="Random inverse depths exceed the range of those of the map's points by this "
        "share.",
    )
    cost: CostOptions = Field(CostOptions(), description="The cost of a plane.")


class AgreementOptions(Config):
    """Limits within which depth maps agree, and which depths are kept."""

    same_px: float = Field(
        1.0,
        gt=0,
        description="Two maps agree where the round trip of a pixel ends within this "
        "distance (px).",
    )
    same_depth: float = Field(
        0.01,
        gt=0,
        description="Two maps agree where their depths differ by less than this share.",
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
    search: SearchOptions = Field(SearchOptions(), description="The search for planes.")
    agreement: AgreementOptions = Field(
        AgreementOptions(), description="Limits within which depth maps agree, and which are kept."
    )


DEFAULTS: Final = DenseOptions()
"""The default options."""
