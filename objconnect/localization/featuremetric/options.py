"""Options of localizers by alignment: which starts are tried, and when a pose is believed."""

from __future__ import annotations

from pathlib import Path
from typing import Self

from pydantic import Field

from objconnect.learning.folding import Precision
from objconnect.localization.align.options import HypothesisOptions, SolverOptions
from objconnect.localization.coarse.finder import PlaceOptions
from objconnect.localization.featuremetric.acceptance import AcceptanceModel, read_acceptance
from objconnect.localization.featuremetric.corners import CornerOptions
from objconnect.localization.featuremetric.evidence import EvidenceOptions
from objconnect.localization.featuremetric.quantized import QuantizationOptions
from objconnect.localization.featuremetric.references import ReferenceOptions
from objconnect.localization.matching.retrieval import RetrievalOptions
from objconnect.localization.matching.structure import StructureConfig
from objconnect.localization.starts import StartOptions
from objconnect.scene.config import Config
from objconnect.scene.runtime.device import AUTO, Device


class SearchOptions(Config):
    """Which starts are tried in turn, and when a pose is believed."""

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
    evidence: EvidenceOptions = Field(
        EvidenceOptions(), description="How a pose is compared with others of the same query."
    )
    first_places: int = Field(
        4,
        ge=1,
        description="Places of objects, and of the place search, that are tried before further "
        "places of either.",
    )
    matched_answer_inliers: int = Field(
        100,
        ge=4,
        description="A pose from matches of so many inliers is the answer. On the validation "
        "scenes such poses were off by 0.02 m in the median, and by 0.04 m after an alignment.",
    )
    matched_radius_m: float = Field(
        1.0, gt=0, description="Distance to look around a pose from matches, metres."
    )
    matched_radius_deg: float = Field(
        1.0, gt=0, description="Angle to look around a pose from matches."
    )
    covariance_factor: float = Field(
        1.28,
        gt=0,
        description="Factor on the covariance that the alignment measures where the fit is that of "
        "the map's season, from 100 patches of the query. python -m experiments.covariance "
        "finds this and the next seven.",
    )
    covariance_patches_power: float = Field(
        0.205,
        ge=0,
        description="Power of the number of patches, as a share of 100, by which the covariance is "
        "divided: it is measured too small from few of them.",
    )
    covariance_level: float = Field(
        3.71e-4,
        gt=0,
        description="Level of the scatter of the patches' pulls, as a share of the curvature of "
        "the cost, that queries have in general.",
    )
    covariance_level_patches: float = Field(
        2.82,
        ge=0,
        description="Number of equal patches of a query as which this level counts beside what "
        "the query's own patches show: their level is not known well from few of them.",
    )
    covariance_floor: float = Field(
        8.59e-5,
        ge=0,
        description="Standard deviation, per axis, of what moves all points alike, as shadows do "
        "when the sun moves: radians, and metres per metre to the points.",
    )
    covariance_unchanged_fit: float = Field(
        0.548,
        gt=0,
        description="Fit of the points by how much they tell of the pose, below which light and "
        "season are the map's and nothing is added to the covariance, for a query that sees the "
        "points from where the map's photographs do.",
    )
    covariance_view_fit: float = Field(
        0.413,
        ge=0,
        description="How much that fit grows with 1 less the mean cosine of the angle between the "
        "directions in which the query and the map's photographs see the points.",
    )
    covariance_changed_fit: float = Field(
        0.316,
        gt=0,
        description="Share by which the fit is worse than in the map's season where the whole of "
        "covariance_floor is added; below, the variance that is added grows in proportion.",
    )
    compared_points: int = Field(
        512,
        ge=10,
        description="Points by which several starts are compared; the best is aligned to all.",
    )
    compared_levels: int = Field(
        2,
        ge=1,
        description="Levels, from the coarsest, on which starts are compared.",
    )
    radius_m: float = Field(8.0, gt=0, description="Least distance to look around a start, metres.")
    radius_deg: float = Field(10.0, gt=0, description="Least angle to look around a start.")
    max_radius_m: float = Field(
        40.0,
        gt=0,
        description="Largest distance to look around a start, metres: a wider grid has gaps.",
    )
    max_radius_deg: float = Field(30.0, gt=0, description="Largest angle to look around a start.")
    prior_sigmas: float = Field(
        2.0, gt=0, description="Standard deviations of the prior that the search reaches."
    )
    place_sigmas: float = Field(
        3.0,
        gt=0,
        description="Standard deviations of the prior's position within which a place of objects "
        "may be.",
    )
    hypotheses: HypothesisOptions = Field(
        HypothesisOptions(), description="How poses around a start are placed and refined."
    )
    again: int = Field(
        2,
        ge=1,
        description="Where no pose around a prior, or from photographs that a query names, is "
        "believed, the search begins again with so many times the hypotheses and compared points; "
        "1 for not.",
    )

    def times(self, factor: int) -> SearchOptions:
        """Return options of a search with so many times the hypotheses and compared points."""
        return self.model_copy(
            update={
                "compared_points": factor * self.compared_points,
                "hypotheses": self.hypotheses.times(factor),
            }
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
    rough_points: int = Field(
        512, ge=10, description="Most points on levels before the finest, spread over the image."
    )
    reach_cells: float = Field(
        3.0,
        gt=0,
        description="Alignment begins on the finest level of which so many cells are more than the "
        "prediction is unsure by (one standard deviation); where none has such cells, the image "
        "is not followed.",
    )
    rough_convergence: float = Field(
        4.0, ge=1, description="Factor on the step lengths that end a level before the finest."
    )


class FeaturemetricConfig(Config):
    """Options of a localizer by alignment."""

    weights: Path | None = Field(
        None, description="File of the network; None for the one that comes with the project."
    )
    device: Device = AUTO
    references: int = Field(
        5, ge=1, description="Photographs of the map that the query is aligned to, together."
    )
    points: int = Field(2048, ge=10, description="Most points, shared by the references.")
    corners: int = Field(
        2500,
        ge=0,
        description="Corners of each photograph that become points beside the map's own; 0 for "
        "none.",
    )
    longest: int = Field(1024, ge=64, description="Larger images are resized to this side (px).")
    iterations: int = Field(100, ge=1, description="Most steps per level.")
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
    most_tilt_deg: float | None = Field(
        None,
        ge=0,
        description="An image that looks at the ground more flatly than the photographs it is "
        "aligned to, by more than this, is seen as by a camera that is turned down so far; None "
        "leaves it as it is.",
    )
    precision: Precision = Field(
        "float32",
        description="Precision of the convolutions; auto is bfloat16 where the processor has "
        "matrix units for it, else float32.",
    )
    quantized: bool = Field(
        False,
        description="The network sees images in 8-bit integers, twice as fast as in bfloat16, and "
        "the map as ``precision`` says. It needs a processor with VNNI.",
    )
    quantization: QuantizationOptions = Field(
        QuantizationOptions(), description="How the scales of these integers are chosen."
    )
    memory_mb: int = Field(
        1060,
        ge=1,
        description="Memory of the whole process; features of the map stay in memory as far as "
        "there is room below it beside a pass of the network.",
    )
    return_freed_mb: int = Field(
        290,
        ge=0,
        description="A query that begins with so much more memory than the map took gives back "
        "what the queries before it freed; a pass that takes it again is a tenth slower.",
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
        SearchOptions(), description="Which starts are tried, and when a pose is believed."
    )
    starts: StartOptions = Field(
        StartOptions(), description="Which starting poses an incomplete prior gives."
    )
    tracking: TrackingOptions | None = Field(
        TrackingOptions(),
        description="How an image of a sequence is followed; where the track is not confirmed, and "
        "with None, it is localized as any other image near its prior.",
    )
    solver: SolverOptions = Field(
        SolverOptions(), description="How the cost of a level is minimised."
    )
    reference: ReferenceOptions = Field(
        ReferenceOptions(), description="Which points are kept of each photograph of the map."
    )
    corner: CornerOptions = Field(
        CornerOptions(), description="How corners of the map's photographs are found and placed."
    )
    retrieval: RetrievalOptions = Field(
        RetrievalOptions(), description="How photographs are chosen where there is no prior."
    )

    def accepting(self) -> Self:
        """Return the options with the acceptance model of their weights.

        Raises:
            InputError: the file of the model is damaged.
        """
        if self.search.acceptance is not None:
            return self
        model = read_acceptance(self.weights)
        search = self.search.model_copy(update={"acceptance": model})
        return self.model_copy(update={"search": search})


class SearchingConfig(FeaturemetricConfig):
    """Options of a localizer that looks around its start and finds starts itself where no prior
    gives them. It aligns to more photographs: what snow hides in one may be seen in another."""

    references: int = Field(8, ge=1)
    precision: Precision = Field("auto", validate_default=True)
    multistart: bool = True
    max_magnification: float = Field(2.0, ge=1)
    most_tilt_deg: float | None = Field(30.0, ge=0)
    place: PlaceOptions = Field(PlaceOptions())
    matches: StructureConfig | None = Field(StructureConfig())
    starts: StartOptions = Field(StartOptions(same_place_m=3.0))
