"""Options of training: how pairs of images are drawn, and the weights of the losses."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

from objconnect.scene.config import Config

Positive = Annotated[float, Field(gt=0)]


class PairOptions(Config):
    """How pairs of images are drawn, from scenes and from single photographs."""

    min_overlap: float = Field(
        0.3,
        gt=0,
        lt=1,
        description="Share of each other's ground that two frames of a scene must see.",
    )
    max_turn_deg: float = Field(
        45.0,
        gt=0,
        le=180,
        description="Largest angle between the headings of two frames after both are turned north "
        "up, as networks take them. A small network cannot learn from a pair with a larger one.",
    )
    heading_deg: float = Field(
        8.0,
        ge=0,
        description="Largest error of an aircraft's heading, by which pictures are turned north "
        "up.",
    )
    cross_share: float = Field(
        0.65,
        ge=0,
        le=1,
        description="Share of the pairs whose frames are of different conditions.",
    )
    zoom: tuple[Positive, Positive] = Field(
        (0.5, 1.2), description="Range of the size of crops relative to the frames."
    )
    level_share: float = Field(
        0.85,
        ge=0,
        le=1,
        description="Share of pairs whose frames of different heights are resized to the same "
        "metres per pixel.",
    )
    objects: bool = Field(
        False,
        description="Whether pairs of scenes know their objects, which the training of objects "
        "needs.",
    )


class LossOptions(Config):
    """The weights of the losses relative to the contrastive loss (nats)."""

    pose_share: float = Field(
        0.3, ge=0, description="Weight of the pose loss (pixels). Finally both are about one."
    )
    trust_share: float = Field(0.3, ge=0, description="Weight of the loss of the confidence.")
    feature_share: float = Field(
        0.1,
        ge=0,
        description="Weight of the distance of features, equation (7), in objconnect.",
    )


PAIRS: Final = PairOptions()
"""The default options of pairs."""
LOSSES: Final = LossOptions()
"""The default weights of the losses."""
