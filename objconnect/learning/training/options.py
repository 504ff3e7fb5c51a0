"""Options of training: pairs of images, and the weights of the losses."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

from objconnect.scene.config import Config

Positive = Annotated[float, Field(gt=0)]


class PairOptions(Config):
    """Options of training pairs from scenes and from single photographs."""

    min_overlap: float = Field(
        0.3,
        gt=0,
        lt=1,
        description="Least share of the ground in each frame of a pair that the other frame shows "
        "too.",
    )
    max_turn_deg: float = Field(
        45.0,
        gt=0,
        le=180,
        description="Largest angle between the cameras of a pair after both are rotated north up, "
        "like all network inputs, deg. A small network cannot learn from pairs with a larger "
        "angle.",
    )
    heading_deg: float = Field(
        8.0,
        ge=0,
        description="Largest error of the heading by which pictures are rotated north up, deg.",
    )
    cross_share: float = Field(
        0.65,
        ge=0,
        le=1,
        description="Share of the pairs with frames of different conditions.",
    )
    zoom: tuple[Positive, Positive] = Field(
        (0.5, 1.2), description="Range of the scale of crops: pixels per pixel of the frame."
    )
    level_share: float = Field(
        0.85,
        ge=0,
        le=1,
        description="Share of the pairs whose frames are resized to the same ground resolution.",
    )
    objects: bool = Field(
        False,
        description="Add the true objects to pairs of scenes, for the training of the detector.",
    )


class LossOptions(Config):
    """The weights of the losses relative to the contrastive loss (nats)."""

    pose_share: float = Field(
        0.3,
        ge=0,
        description="Weight of the pose loss (px). At the end of training, the pose loss and the "
        "contrastive loss are both about one.",
    )
    trust_share: float = Field(0.3, ge=0, description="Weight of the loss of the confidence.")
    feature_share: float = Field(
        0.1,
        ge=0,
        description="Weight of the distance of features, equation (7) of the object-connect paper; "
        "used by the method objconnect alone.",
    )


PAIRS: Final = PairOptions()
"""The default options of pairs."""
LOSSES: Final = LossOptions()
"""The default weights of the losses."""
