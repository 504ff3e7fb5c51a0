"""Options of training: how pairs of images are drawn, and the weights of the losses."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

from objconnect.scene.config import Config

Positive = Annotated[float, Field(gt=0)]


class PairOptions(Config):
    """How pairs of images are drawn, from scenes and from single photographs.

    Attributes:
        min_overlap: share of each other's ground that two frames of a scene must see.
        max_turn_deg: largest angle between the headings of two frames after both are turned north
            up, as networks take them. A small network cannot learn from a pair with a larger one.
        heading_deg: largest error of an aircraft's heading, by which pictures are turned north up.
        cross_share: share of the pairs whose frames are of different conditions.
        zoom: range of the size of crops relative to the frames.
        level_share: share of pairs whose frames of different heights are resized to the same metres
            per pixel.
        border_px: points closer to the edge of an image are left out.
        min_points: a pair with fewer points is drawn again.
        same_depth: largest relative difference of two depths of the same point.
        start_deg: largest rotation of the start of an alignment from the truth.
        start_share: largest translation of the start from the truth, as a share of the depth. Both
            are as large as the errors of an aircraft's own pose.
        corner_threshold: threshold of FAST, grey levels.
        corner_share: share of the points that lie at corners. The other points are random, so that
            features of plain ground are trained too.
        objects: whether pairs of scenes know their objects, which the training of objects needs.
        plane_height_m: height of the cameras over single photographs, which are treated as flat
            ground.
        plane_tilt_deg: largest tilt of these cameras about each axis.
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
    objects: bool = False
    plane_height_m: float = Field(80.0, gt=0)
    plane_tilt_deg: float = Field(15.0, ge=0)


class ContrastOptions(Config):
    """The negatives of the contrastive loss.

    Attributes:
        temperature: temperature by which the cosines are divided.
        elsewhere: number of random negatives in the image.
        beside: distances (cells) of further negatives from the true place. They make the peak of
            the similarity sharp, and wide enough for alignment to converge.
        same_place: negatives closer than this (cells) to the true place are left out.
    """

    temperature: float = Field(0.07, gt=0)
    elsewhere: int = Field(512, ge=1)
    beside: tuple[Positive, ...] = Field((1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0), min_length=1)
    same_place: float = Field(1.0, ge=0)


class ObjectLossOptions(Config):
    """The losses of learned objects: their weights, and which objects count in them.

    Attributes:
        centres: weight of the heat map of centres.
        inside: weight of which cells belong to an object.
        offsets: weight of the distance of offsets to centres, cells.
        sides: weight of the distance of the logarithms of sides.
        rises: weight of the distance of heights above ground, logarithms of sides.
        identity: weight of the contrastive loss of vectors.
        temperature: temperature by which the cosines of vectors are divided.
        min_pixels: objects of which an image shows fewer pixels need not be found.
        spread: spread of a centre in the heat map as a share of the object's side.
        far_share: share of an offset's length that counts as its uncertainty.
    """

    centres: float = Field(1.0, ge=0)
    inside: float = Field(1.0, ge=0)
    offsets: float = Field(0.5, ge=0)
    sides: float = Field(0.3, ge=0)
    rises: float = Field(0.3, ge=0)
    identity: float = Field(0.5, ge=0)
    temperature: float = Field(0.1, gt=0)
    min_pixels: int = Field(12, ge=1)
    spread: float = Field(0.17, gt=0)
    far_share: float = Field(0.15, ge=0)

    def shares(self) -> dict[str, float]:
        """Return the weight of each loss of places by name."""
        names = ("centres", "inside", "offsets", "sides", "rises")
        return {name: getattr(self, name) for name in names}


class LossOptions(Config):
    """The weights of the losses, and which points and pairs count in them.

    Attributes:
        contrast: negatives of the contrastive loss.
        objects: losses of learned objects.
        pose_share: weight of the pose loss (pixels) relative to the contrastive loss (nats).
            Finally both are about one.
        trust_share: weight of the loss of the confidence.
        feature_share: weight of the distance of features, equation (7), in objconnect.
        pose_clamp_px: largest error that counts in the pose loss of a level.
        near_cells: a level counts only where the error after the coarser level is below this many
            of its cells.
        min_points: pairs with fewer points are left out of the pose loss.
        min_object_points: objects with fewer points are left out of the loss of their confidence.
        iterations: number of iterations of the alignment whose poses the pose loss measures.
        damping_rate: learning rate of the damping relative to the filters'. It is large because a
            factor is shared by all pixels.
        triplet_margin: margin of D2-Net's triplet loss, squared distance.
        triplet_safe_radius: descriptors within this many cells (Chebyshev distance) of the true
            place are no negatives of a triplet.
        triplet_min_points: least number of correspondences of a pair in the triplet loss, as the
            authors have it, or half of the number that a batch has room for if that is less.
    """

    contrast: ContrastOptions = ContrastOptions()
    objects: ObjectLossOptions = ObjectLossOptions()
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
"""The default options of pairs."""
LOSSES: Final = LossOptions()
"""The default options of the losses."""
