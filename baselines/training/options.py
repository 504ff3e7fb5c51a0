"""Options of training: how pairs of images are drawn, and what the losses weigh."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

from scene.config import Config

Positive = Annotated[float, Field(gt=0)]


class PairOptions(Config):
    """How pairs of images are drawn, from scenes and from single photographs.

    Attributes:
        min_overlap: share of each other's ground that two frames of a scene must see.
        max_turn_deg: pictures are turned north up before a network sees them. Frames that are then
            still turned against each other by more show each other nothing a slim network could
            learn.
        heading_deg: what an aircraft's belief about its heading may be off by.
        cross_share: share of the pairs whose frames are of different conditions.
        zoom: range of the size of crops over the frames'.
        level_share: share of the pairs whose frames, flown at different heights, are brought to the
            same metres per pixel.
        border_px: points closer to the edge of an image do not count.
        min_points: a pair with fewer points is drawn again.
        same_depth: two depths of one place agree within this share.
        start_deg: the start of the alignment is turned by up to this.
        start_share: and moved by up to this share of the depth; an aircraft's own belief may be as
            far off.
        corner_threshold: of FAST, grey levels.
        corner_share: share of the points that lie at corners; the rest lies anywhere, so that plain
            ground is learned too.
        plane_height_m: of the cameras over single photographs, which are taken for flat ground.
        plane_tilt_deg: these cameras are tilted by up to this about each axis.
    """

    min_overlap: float = Field(0.3, gt=0, lt=1)
    max_turn_deg: float = Field(45.0, gt=0, le=180)
    heading_deg: float = Field(8.0, ge=0)
    cross_share: float = Field(0.65, ge=0, le=1)
    zoom: tuple[Positive, Positive] = (0.5, 1.2)
    level_share: float = Field(0.85, ge=0, le=1)
    border_px: float = Field(4.0, ge=0)
    min_points: int = Field(64, ge=1)
    same_depth: float = Field(0.01, gt=0)
    start_deg: float = Field(10.0, ge=0)
    start_share: float = Field(0.08, ge=0)
    corner_threshold: int = Field(8, ge=1)
    corner_share: float = Field(0.75, ge=0, le=1)
    plane_height_m: float = Field(80.0, gt=0)
    plane_tilt_deg: float = Field(15.0, ge=0)


class ContrastOptions(Config):
    """What a point's feature is contrasted with.

    Attributes:
        temperature: that the cosines are divided by.
        elsewhere: other places of the image, at random.
        beside: distances (cells) of further places beside the true one: they make the peak sharp,
            and wide enough to be climbed.
        same_place: other places closer than this (cells) to the true one do not count.
    """

    temperature: float = Field(0.07, gt=0)
    elsewhere: int = Field(512, ge=1)
    beside: tuple[Positive, ...] = Field((1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0), min_length=1)
    same_place: float = Field(1.0, ge=0)


class LossOptions(Config):
    """What the losses weigh, and which points and pairs count in them.

    Attributes:
        contrast: of the contrastive loss.
        pose_share: weight of the pose loss. It is in pixels and the contrastive loss in nats: at
            the end both are about one.
        trust_share: weight of the loss of the confidence.
        feature_share: weight of the distance of features, equation (7), in objconnect.
        pose_clamp_px: the pose loss of a level grows no further from here.
        near_cells: a level counts only where the coarser one ended within this distance.
        min_points: a pair with fewer points counts for nothing in the pose loss.
        min_object_points: objects with fewer points are left out of the loss of their confidence.
        iterations: of the alignment that the pose loss is taken of.
        damping_rate: learning rate of the damping over that of the network: it is one number for
            all pixels and needs larger steps.
        triplet_margin: of D2-Net's triplet loss, squared distance.
        triplet_safe_radius: cells (Chebyshev) from the true place within which a descriptor is no
            negative of a triplet.
        triplet_min_points: correspondences without which a pair has no triplet loss, as the authors
            have it; half of what a batch has room for where that is less.
    """

    contrast: ContrastOptions = ContrastOptions()
    pose_share: float = Field(0.3, ge=0)
    trust_share: float = Field(0.3, ge=0)
    feature_share: float = Field(0.1, ge=0)
    pose_clamp_px: float = Field(50.0, gt=0)
    near_cells: float = Field(3.0, gt=0)
    min_points: int = Field(10, ge=1)
    min_object_points: int = Field(4, ge=1)
    iterations: int = Field(8, ge=1)
    damping_rate: float = Field(30.0, gt=0)
    triplet_margin: float = Field(1.0, ge=0)
    triplet_safe_radius: int = Field(4, ge=0)
    triplet_min_points: int = Field(128, ge=1)


PAIRS: Final = PairOptions()
"""The default of how pairs are drawn."""
LOSSES: Final = LossOptions()
"""The default of what the losses weigh."""
