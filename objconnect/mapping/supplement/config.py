"""Options of ``supplement``: association and triangulation of detections."""

from __future__ import annotations

from pydantic import Field

from objconnect.scene.config import Config


class SupplementConfig(Config):
    """Thresholds of association and triangulation.

    The command ``supplement`` uses ``views``, ``reprojection_px`` and ``angle_deg`` alone; the
    function ``associate_and_triangulate`` uses all.
    """

    neighbours: int = Field(
        12,
        ge=1,
        description="Number of photographs with which each photograph is compared; they share the "
        "most map points with it.",
    )
    epipolar_px: float = Field(
        2.0,
        gt=0,
        description="Maximum epipolar error of two detections of one object, px.",
    )
    similarity: float = Field(
        0.8,
        ge=-1,
        le=1,
        description="Minimum cosine similarity of descriptors of one object, -1 to 1.",
    )
    reprojection_px: float = Field(
        2.0, gt=0, description="Maximum reprojection error of a point's detection, px."
    )
    views: int = Field(3, ge=2, description="Minimum number of photographs that observe a point.")
    angle_deg: float = Field(
        3.0, gt=0, lt=90, description="Minimum triangulation angle of a point, deg."
    )
