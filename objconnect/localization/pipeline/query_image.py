"""An image to localize with its metadata."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from objconnect.localization.pipeline.cameras import Calibration
from objconnect.scene.localizer import Prior, Query


@dataclass(frozen=True)
class QueryImage:
    """A photograph or a frame of a video with its metadata.

    Attributes:
        name: name in the output.
        query: the image with its camera and its prior; None if the image cannot be localized.
        calibration: camera of the image, or cameras to try; None if unknown.
        time: time at which the image was taken; None if unknown.
        seconds: time from the start of its sequence; None without a sequence, or if unknown.
        gps: position that a receiver measured, in the map's frame; None without one.
        doubts: metadata or telemetry that is missing, uncertain or not used.
        reason: why the image cannot be localized; empty if it can.
    """

    name: str
    query: Query | None = None
    calibration: Calibration | None = None
    time: datetime | None = None
    seconds: float | None = None
    gps: Prior | None = None
    doubts: tuple[str, ...] = ()
    reason: str = ""
