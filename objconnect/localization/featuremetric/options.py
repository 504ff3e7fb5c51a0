"""Options of localizers by alignment: which starts are tried, and when a pose is believed."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Self

from pydantic import Field

from objconnect.learning.inference import Precision
from objconnect.localization.coarse.finder import PlaceOptions
from objconnect.localization.featuremetric.acceptance import AcceptanceModel
from objconnect.localization.featuremetric.calibration import CovarianceNumbers
from objconnect.localization.featuremetric.corners import CornerOptions
from objconnect.localization.matching.structure import StructureConfig
from objconnect.scene.config import Config, with_default
from objconnect.scene.runtime.device import AUTO, Device


class SearchOptions(Config):
    """When a pose is believed, and what a search does until then."""

    risk: float = Field(
        0.05,
        gt=0,
        le=1,
        description="A pose is believed where the probability that it is wrong, by more than 5 m "
        "or 10 degrees, is at most this. It is a bound for each answer: of all answers far fewer "
        "are wrong. A search goes on until a pose is believed. 1 believes every pose.",
    )
    most_sigma_m: float = Field(
        1.0,
        gt=0,
        description="An aligned pose is not answered where its position has a larger predicted "
        "standard deviation, metres.",
    )
    acceptance: AcceptanceModel | None = Field(
        None,
        description="Model of the probability that a pose is right. None reads it from the file "
        "beside weights of your own (own.acceptance.yaml beside own.safetensors); without one it "
        "is that of the networks that come with the project. "
        "python -m experiments.acceptance finds it.",
    )
    covariance: CovarianceNumbers | None = Field(
        None,
        description="How covariances of poses are calibrated. None reads it from the file beside "
        "weights of your own (own.covariance.yaml beside own.safetensors); without one it is that "
        "of the networks that come with the project. python -m experiments.covariance finds it.",
    )
    matched_answer_inliers: int = Field(
        100,
        ge=4,
        description="A pose from matches of so many inliers is the answer. On the validation "
        "scenes such poses were off by 0.02 m in the median, and by 0.04 m after an alignment.",
    )
    again: int = Field(
        2,
        ge=1,
        description="Where no pose around a prior, or from photographs that a query names, is "
        "believed, the search begins again with so many times the starts and points; 1 for not.",
    )


class TrackingOptions(Config):
    """How an image of a sequence is followed from the pose that the ones before predict."""

    coarser: float | None = Field(
        None,
        gt=0,
        description="Metres of ground per pixel at which the image is looked at, over those of the "
        "map's photographs, as the network takes time by area; it is never enlarged. None is as in "
        "any query, which leaves an image as it is where both are nearly the same.",
    )
    side: float = Field(
        1.0,
        gt=0,
        description="Side of the middle of the picture, north up, that is looked at, as a share of "
        "the photograph's longer side: corners that stick out of it are left out.",
    )
    references: int = Field(
        4, ge=1, description="Photographs of the map that the image is aligned to, together."
    )
    points: int = Field(2048, ge=10, description="Most points, shared by the references.")


class FeaturemetricConfig(Config):
    """Options of a localizer by alignment."""

    weights: Path | None = Field(
        None, description="File of the network; None for the one that comes with the project."
    )
    device: Device = AUTO
    references: int = Field(
        5, ge=1, description="Photographs of the map that the query is aligned to, together."
    )
    corners: CornerOptions | None = Field(
        CornerOptions(),
        description="Corners of the map's photographs that become points beside the map's own; "
        "None for none.",
    )
    longest: int = Field(1024, ge=64, description="Larger images are resized to this side (px).")
    max_magnification: float = Field(
        1.0,
        ge=1,
        description="Images coarser than the map are magnified at most this much to reach its "
        "resolution, once a pose is found by ``multistart``.",
    )
    multistart: bool = Field(
        False,
        description="Look around the start too, for priors beyond the reach of the features.",
    )
    precision: Precision = Field(
        "float32",
        validate_default=True,
        description="Precision of the convolutions; auto is bfloat16 where the processor has "
        "matrix units for it, else float32.",
    )
    quantized: bool = Field(
        False,
        description="The network sees images in 8-bit integers, twice as fast as in bfloat16, and "
        "the map as ``precision`` says. It needs a processor with VNNI.",
    )
    memory_mb: int = Field(
        1060,
        ge=1,
        description="Memory of the whole process; features of the map stay in memory as far as "
        "there is room below it beside a pass of the network.",
    )
    place: PlaceOptions = Field(
        PlaceOptions(candidates=0),
        description="Search of the map for images whose position or heading is not known; it "
        "needs ``multistart``, and no candidates mean no search.",
    )
    matches: StructureConfig | None = Field(
        None,
        description="Matches of SIFT features, which are tried before the search; None for none.",
    )
    search: SearchOptions = Field(
        SearchOptions(), description="When a pose is believed, and how far the search goes."
    )
    tracking: TrackingOptions | None = Field(
        TrackingOptions(),
        description="How an image of a sequence is followed; where the track is not confirmed, and "
        "with None, it is localized as any other image near its prior.",
    )
    most_tilt_deg: ClassVar[float | None] = None
    """An image that looks at the ground more flatly than the photographs it is aligned to, by more
    than this, is seen as by a camera that is turned down so far; None leaves it as it is."""
    same_place_m: ClassVar[float | None] = None
    """Where nothing is known of a query, photographs farther apart than this (metres) are starts of
    their own, though they share a heading; None for never."""

    def with_calibration(self) -> Self:
        """Return the options with the acceptance model and the covariance of their weights.

        Raises:
            InputError: a file beside the weights is damaged.
        """
        search = self.search
        read = {
            "acceptance": search.acceptance or AcceptanceModel.beside(self.weights),
            "covariance": search.covariance or CovarianceNumbers.beside(self.weights),
        }
        return self.model_copy(update={"search": search.model_copy(update=read)})


class SearchingConfig(FeaturemetricConfig):
    """Options of a localizer that looks around its start and finds starts itself where no prior
    gives them. It aligns to more photographs: what snow hides in one may be seen in another."""

    references: int = with_default(FeaturemetricConfig, "references", 8)
    precision: Precision = with_default(FeaturemetricConfig, "precision", "auto")
    multistart: bool = with_default(FeaturemetricConfig, "multistart", True)
    max_magnification: float = with_default(FeaturemetricConfig, "max_magnification", 2.0)
    place: PlaceOptions = with_default(FeaturemetricConfig, "place", PlaceOptions())
    matches: StructureConfig | None = with_default(
        FeaturemetricConfig, "matches", StructureConfig()
    )
    most_tilt_deg: ClassVar[float | None] = 30.0
    same_place_m: ClassVar[float | None] = 3.0
