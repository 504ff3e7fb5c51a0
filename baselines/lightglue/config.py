"""Options of the localizers that match with LightGlue."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

from pydantic import Field

from objconnect.localization.matching.structure import MatchingConfig
from objconnect.scene.runtime.device import AUTO, Device


class LightGlueConfig(MatchingConfig):
    """Options of a localizer that matches with LightGlue, in addition to ``MatchingConfig``."""

    weights: Path | None = Field(
        None, description="File of the extractor's weights; None lets kornia download them."
    )
    matcher_weights: Path | None = Field(
        None, description="File of LightGlue's weights; None lets kornia download them."
    )
    device: Device = AUTO
    max_features: int = Field(2048, ge=100, description="Maximum number of features of an image.")
    min_confidence: float = Field(
        0.1, ge=0, lt=1, description="Minimum confidence of a match, as LightGlue states it."
    )
    magnification: float = Field(
        2.0,
        gt=0,
        le=8,
        description="Factor by which images are resized before extraction; less where their longer "
        "side would exceed 2048 pixels. A keypoint's position is accurate to about one "
        "pixel of the resized image.",
    )


class AlikedLightGlueConfig(LightGlueConfig):
    """Options of the localizer ``aliked+lightglue``."""

    extractor: Literal["aliked-n16", "aliked-n16rot", "aliked-n32"] = Field(
        "aliked-n16",
        description="Weights of ALIKED, by kornia's name. LightGlue was trained with aliked-n16.",
    )


class DiskLightGlueConfig(LightGlueConfig):
    """Options of the localizer ``disk+lightglue``."""

    extractor: ClassVar[str] = "depth"
    """Weights of DISK, by kornia's name: LightGlue was trained with them."""
