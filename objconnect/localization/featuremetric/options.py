"""Options of localizers by alignment."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Self

from pydantic import Field, field_validator

from objconnect.learning.inference import Precision
from objconnect.localization.coarse.finder import CoarseSearchOptions
from objconnect.localization.featuremetric.acceptance import AcceptanceModel
from objconnect.localization.featuremetric.calibration import CovarianceModel
from objconnect.localization.featuremetric.corners import CornerOptions
from objconnect.localization.matching.structure import StructureConfig
from objconnect.scene.config import Config, with_default
from objconnect.scene.errors import InputError
from objconnect.scene.runtime.device import AUTO, Device


class SearchOptions(Config):
    """Options of acceptance and of the search for a pose."""

    risk: float = Field(
        0.05,
        gt=0,
        le=1,
        description="Largest probability that an accepted pose is wrong by more than 5 m or 10 "
        "deg. This bounds the risk of every single answer; the share of wrong answers is far "
        "lower. A search ends at the first pose within this risk. 1 accepts poses of any "
        "probability.",
    )
    most_sigma_m: float = Field(
        1.0,
        gt=0,
        description="Largest predicted standard deviation of the position of an aligned pose, m; "
        "a pose with a larger deviation is rejected.",
    )
    least_peak: float = Field(
        3.5,
        ge=0,
        description="Least peak-to-sidelobe ratio of a rough alignment at which a candidate of a "
        "search is aligned at full resolution; the first candidate is always. There the ratio must "
        "be 1.15 times as large, or the alignment ends early. 0 aligns all candidates to the end, "
        "which takes longer.",
    )
    acceptance: AcceptanceModel | None = Field(
        None,
        description="Model of the probability that a pose is right. None reads the file beside "
        "your own weights (own.acceptance.yaml beside own.safetensors), or the file of the "
        "shipped networks if there is none. python -m experiments.acceptance fits it.",
    )
    covariance: CovarianceModel | None = Field(
        None,
        description="Calibration of the covariances of poses. None reads the file beside your own "
        "weights (own.covariance.yaml beside own.safetensors), or the file of the shipped networks "
        "if there is none. python -m experiments.covariance fits it.",
    )
    matched_answer_inliers: int = Field(
        100,
        ge=4,
        description="Minimum number of inliers at which a pose from SIFT matches is returned "
        "without an alignment, if it is within ``risk``. On the validation scenes such poses were "
        "off by 0.02 m in the median, and by 0.04 m after an alignment.",
    )
    again: int = Field(
        2,
        ge=1,
        description="Factor on the numbers of poses and points that a second search compares, if "
        "no pose around a prior, or around the reference images that a query names, is accepted; "
        "1 for no second search. Without ``multistart`` there is none.",
    )
    matcher: dict[str, Any] | None = Field(
        None,
        description="Second method, such as aliked+lightglue, that is run if no pose is "
        "accepted; its pose is one more initial pose. None for none. Its options follow it: "
        "search.matcher.method=aliked+lightglue and search.matcher.references=8.",
    )

    @field_validator("matcher", mode="before")
    @classmethod
    def _complete_matcher(cls, value: Any) -> Any:
        """Replace the bare name of a method with a mapping that has only this name."""
        if isinstance(value, str):
            return {"method": value}
        if isinstance(value, Mapping) and not isinstance(value.get("method"), str):
            raise ValueError("give the name of a method, as search.matcher.method=aliked+lightglue")
        return value


class TrackingOptions(Config):
    """Options of the alignment of an image of a sequence from its predicted pose."""

    coarser: float | None = Field(
        None,
        gt=0,
        description="Metres per pixel of the resized image as a multiple of those of the map's "
        "photographs; larger values take less time, and images are never enlarged. None resizes "
        "to the photographs' resolution, unless the image nearly has it already.",
    )
    side: float = Field(
        1.0,
        gt=0,
        description="Side of the square that is cropped from the middle of the north-up picture "
        "and aligned, as a share of the photograph's longer side.",
    )
    references: int = Field(
        4, ge=1, description="Number of reference images that the image is aligned to jointly."
    )
    points: int = Field(
        2048, ge=10, description="Maximum number of points of all reference images together."
    )


class NetworkOptions(Config):
    """The network of a localizer, and where it runs."""

    weights: Path | None = Field(
        None,
        description="File of the network's weights, or published weights: a folder or "
        "hf://OWNER/NAME@COMMIT; None for the shipped ones.",
    )
    device: Device = AUTO


class FeaturemetricConfig(NetworkOptions):
    """Options of a localizer by alignment."""

    references: int = Field(
        5, ge=1, description="Number of reference images that the query is aligned to jointly."
    )
    corners: CornerOptions | None = Field(
        CornerOptions(),
        description="Corners of the map's photographs as points in addition to the map's own; "
        "None for none.",
    )
    longest: int = Field(
        1024, ge=64, description="Larger images are resized to this longer side, px."
    )
    max_magnification: float = Field(
        1.0,
        ge=1,
        description="Largest factor by which images coarser than the map are magnified to its "
        "resolution, after ``multistart`` gave a pose.",
    )
    multistart: bool = Field(
        False,
        description="Search around the initial pose, for priors with larger errors than one "
        "alignment corrects.",
    )
    precision: Precision = Field(
        "float32",
        validate_default=True,
        description="Precision of the convolutions; auto is bfloat16 on processors that compute "
        "faster in it (Intel's AMX, AMD's AVX-512 with bfloat16), else float32.",
    )
    quantized: bool = Field(
        False,
        description="Run the network on queries in 8-bit integers, twice as fast as in bfloat16, "
        "and on the map in ``precision``. It needs a processor with VNNI.",
    )
    memory_mb: int = Field(
        1060,
        ge=1,
        description="Memory of the whole process, MB; features of the map stay in memory as far as "
        "there is room beside a pass of the network.",
    )
    place: CoarseSearchOptions = Field(
        CoarseSearchOptions(candidates=0),
        description="Coarse search of the map for images without position or heading. It needs "
        "``multistart``; 0 candidates switch it off.",
    )
    matches: StructureConfig | None = Field(
        None,
        description="SIFT matches, which are tried before the search; None for none. They need "
        "``multistart``.",
    )
    search: SearchOptions = Field(
        SearchOptions(), description="Acceptance of poses, and the extent of the search."
    )
    tracking: TrackingOptions | None = Field(
        TrackingOptions(),
        description="Alignment of an image of a sequence from its predicted pose. If its pose is "
        "not accepted, or with None, the image is localized as any other with a prior.",
    )
    most_tilt_deg: ClassVar[float | None] = None
    """An image whose tilt exceeds the median tilt of its reference images by more than this angle
    (degrees) is warped so that its tilt exceeds the median by exactly this angle. The warp rotates
    the optical axis by at most 45 degrees. None warps no image."""
    same_place_m: ClassVar[float | None] = None
    """Without any prior, reference images farther apart than this (metres) are separate starts
    even if they have the same heading. None: they have one start per heading."""

    def drop_ineffective(self) -> Self:
        """Return the options; without ``multistart``, those that need it are switched off.

        Raises:
            InputError: an option is given that has no effect without ``multistart``.
        """
        if self.multistart:
            return self
        off = self._switched_off()
        useless = [n for n in off if n in self.model_fields_set and getattr(self, n) != off[n]]
        # A worker of a cluster gets all recorded options, so the default must be accepted.
        if self.search.again not in (1, SearchOptions().again):
            useless.append("search.again")
        for name in useless:
            raise InputError(
                f"option {name} has no effect without multistart: give multistart=true, or leave "
                f"{name} out"
            )
        return self.model_copy(update=off)

    def _switched_off(self) -> dict[str, Any]:
        """Return the values that switch off options that need ``multistart``, by option."""
        return {
            "place": self.place.model_copy(update={"candidates": 0}),
            "matches": None,
            "max_magnification": 1.0,
        }

    def with_calibration(self) -> Self:
        """Return the options with the acceptance and covariance models of their weights.

        Raises:
            InputError: a file beside the weights is damaged.
        """
        search = self.search
        read = {
            "acceptance": search.acceptance or AcceptanceModel.load_beside(self.weights),
            "covariance": search.covariance or CovarianceModel.load_beside(self.weights),
        }
        return self.model_copy(update={"search": search.model_copy(update=read)})


class SearchingConfig(FeaturemetricConfig):
    """Options of a localizer that searches around a prior, and the whole map without one.

    It aligns to more reference images, because snow may hide points in one image that
    another shows.
    """

    references: int = with_default(FeaturemetricConfig, "references", 8)
    precision: Precision = with_default(FeaturemetricConfig, "precision", "auto")
    multistart: bool = with_default(FeaturemetricConfig, "multistart", True)
    max_magnification: float = with_default(FeaturemetricConfig, "max_magnification", 2.0)
    place: CoarseSearchOptions = with_default(FeaturemetricConfig, "place", CoarseSearchOptions())
    matches: StructureConfig | None = with_default(
        FeaturemetricConfig, "matches", StructureConfig()
    )
    most_tilt_deg: ClassVar[float | None] = 30.0
    same_place_m: ClassVar[float | None] = 3.0
