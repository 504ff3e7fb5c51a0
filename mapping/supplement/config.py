"""When detections are of one object, and when that object becomes a point."""

from __future__ import annotations

from pydantic import Field

from scene.config import Config


class SupplementConfig(Config):
    """Thresholds of association and triangulation.

    Attributes:
        neighbours: photographs that each is compared with: those that share most map points.
        epipolar_px: two detections are of one object when each lies closer to the other's epipolar
            line.
        similarity: cosine of their descriptors from which on they may be.
        reprojection_px: a detection belongs to a point that projects this close to it.
        views: photographs that must agree on a point.
        angle_deg: least angle between two of the rays that made it.
        above_m: least height of a place above the ground around it.
        below_m: largest height likewise.
        likely: least probability of being on a thing, as ``classifier.PlaceClassifier`` sees it.
        apart_m: least distance of a place from the map's own points.
    """

    neighbours: int = Field(12, ge=1)
    epipolar_px: float = Field(2.0, gt=0)
    similarity: float = Field(0.8, ge=-1, le=1)
    reprojection_px: float = Field(2.0, gt=0)
    views: int = Field(3, ge=2)
    angle_deg: float = Field(3.0, gt=0, lt=90)
    above_m: float = Field(0.1, gt=0)
    below_m: float = Field(3.2, gt=0)
    likely: float = Field(0.8, gt=0, lt=1)
    apart_m: float = Field(0.5, ge=0)
