"""Options of the map supplement: association and triangulation of detections."""

from __future__ import annotations

from pydantic import Field

from objconnect.scene.config import Config


class SupplementConfig(Config):
    """Thresholds of association and triangulation."""

    neighbours: int = Field(
        12,
        ge=1,
        description="Photographs that each is compared with: those that share most map points.",
    )
    epipolar_px: float = Field(
        2.0,
        gt=0,
        description="Two detections may be of one object when each lies closer than this to the "
        "other's epipolar line.",
    )
    similarity: float = Field(
        0.8, ge=-1, le=1, description="Least cosine of their descriptors for that."
    )
    reprojection_px: float = Field(
        2.0, gt=0, description="A detection belongs to a point that projects this close to it."
    )
    views: int = Field(3, ge=2, description="Photographs that must agree on a point.")
    angle_deg: float = Field(
        3.0, gt=0, lt=90, description="Least angle between two of the rays that made a point."
    )
