"""Options of ``supplement``: triangulation of detections."""

from __future__ import annotations

from pydantic import Field

from objconnect.scene.config import Config


class SupplementConfig(Config):
    """Thresholds of triangulation."""

    reprojection_px: float = Field(
        2.0, gt=0, description="Maximum reprojection error of a point's detection, px."
    )
    views: int = Field(3, ge=2, description="Minimum number of photographs that observe a point.")
    angle_deg: float = Field(
        3.0, gt=0, lt=90, description="Minimum triangulation angle of a point, deg."
    )
