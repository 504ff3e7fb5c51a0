"""The frames of a video as queries, with priors from the telemetry in its subtitles."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Final

import numpy as np

from objconnect.ingestion.telemetry import Telemetry
from objconnect.localization.pipeline.footage import (
    Footage,
    FrameCameras,
    Timing,
    cameras_of_frames,
)
from objconnect.localization.pipeline.localization_map import LocalizationMap
from objconnect.localization.pipeline.options import LocalizeOptions
from objconnect.localization.pipeline.query_image import QueryImage
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.geometry.gimbal import gimbal_pose
from objconnect.scene.localizer import Estimate, Prior, Query
from objconnect.scene.quantities.coordinate_order import REACH_M
from objconnect.scene.storage.video import decode_frames, frame_name

log = logging.getLogger(__name__)

RATE_HZ: Final = 2.0
"""Default number of video frames to localize per second."""


@dataclass(frozen=True)
class TelemetryReader:
    """Converts telemetry to priors in the frame of a map.

    Attributes:
        localization_map: the map.
        options: standard deviations of positions and attitudes.
        undulation_m: height of the geoid above the ellipsoid; None leaves altitudes unknown.
    """

    localization_map: LocalizationMap
    options: LocalizeOptions
    undulation_m: float | None

    def __call__(self, telemetry: Telemetry | None) -> Prior | None:
        """Return the prior in the map's frame; None if the telemetry has neither a position near
        the map nor an attitude."""
        if telemetry is None:
            return None
        prior = self._position(telemetry)
        if telemetry.gimbal is None:
            return prior
        if prior is None:
            # A prior needs a position. It is the middle of the map's cameras with infinite sigma.
            prior = Prior(
                np.median(self.localization_map.sparse_map.centres, 0), np.full(3, np.inf)
            )
        return replace(
            prior,
            cam_from_world_rotation=gimbal_pose(*telemetry.gimbal).rotation.numpy(),
            attitude_sigma_deg=self.options.gimbal_sigma_deg,
        )

    def _position(self, telemetry: Telemetry) -> Prior | None:
        """Return the prior of the position alone; None if it is unknown or far from the map."""
        origin = self.localization_map.origin
        if telemetry.place is None or origin is None:
            return None
        has_altitude = telemetry.abs_alt is not None and self.undulation_m is not None
        altitude = np.nan
        if has_altitude:
            altitude = (telemetry.abs_alt or 0.0) + (self.undulation_m or 0.0)
        fix, sigma = Geodetic(*telemetry.place, altitude), np.full(3, self.options.gps_sigma_m)
        prior = Prior(*self.localization_map.to_map_frame(fix, origin, sigma))
        return None if np.hypot(*prior.position[:2]) > REACH_M else prior


@dataclass(frozen=True)
class VideoFrames:
    """The frames of a video that are localized, at the rate of ``footage``.

    Attributes:
        footage: the video and its telemetry.
        cameras: cameras of the frames.
        reader: converts telemetry to priors.
    """

    footage: Footage
    cameras: FrameCameras
    reader: TelemetryReader

    @staticmethod
    def open(
        video: Path,
        localization_map: LocalizationMap,
        options: LocalizeOptions,
        undulation_m: float | None,
    ) -> VideoFrames:
        """Read the metadata of a video and the telemetry of its subtitles.

        Args:
            video: MP4 or another file that FFmpeg reads.
            localization_map: map to localize in.
            options: options of the video: subtitles, rate, camera and standard deviations.
            undulation_m: height of the geoid above the ellipsoid; None if unknown.

        Raises:
            InputError: video or subtitles cannot be read, or the camera is unknown.
        """
        footage = Footage.open(video, options.srt, options.rate_hz or RATE_HZ, localization_map)
        reader = TelemetryReader(localization_map, options, undulation_m)
        warn_of_far_telemetry(footage, reader)
        return VideoFrames(
            footage, cameras_of_frames(footage, options.camera, localization_map), reader
        )

    @property
    def count(self) -> int:
        """Return the approximate number of frames to localize."""
        return self.footage.count

    @property
    def record(self) -> Mapping[str, Any]:
        """Return the description of the video for the JSON file that ``localize`` writes."""
        video, srt = self.footage.path.name, self.footage.srt
        srt_name = None if srt is None else srt.name
        return {"video": video, "srt": srt_name, "rate_hz": self.footage.rate_hz}

    def images(self, localize: Callable[[Query], Estimate]) -> Iterator[QueryImage]:
        """Yield the frames with the priors of their telemetry.

        ``localize`` is not used; it is an argument because photographs need it to estimate cameras.
        """
        footage = self.footage
        clock, timing = _clock(footage), Timing.of(footage.telemetry, footage.video)
        for frame in decode_frames(footage.path, footage.rate_hz):
            telemetry = timing.telemetry_of(footage.telemetry, frame)
            calibration, gps = self.cameras.of(telemetry), self.reader(telemetry)
            image = QueryImage(
                frame_name(footage.path.stem, frame.index),
                calibration=calibration,
                time=None if clock is None else clock + timedelta(seconds=frame.seconds),
                seconds=frame.seconds,
                doubts=_doubts(footage, telemetry, self.cameras, self.reader),
            )
            if calibration is None:
                reason = f"{footage.srt} has no focal length or zoom of this frame: give --camera"
                yield replace(image, reason=reason)
                continue
            query = Query(image.name, frame.image, calibration.camera, gps)
            yield replace(image, query=query, gps=gps)

    def warn(self) -> None:
        """Do nothing: telemetry is checked when it is opened."""


def _doubts(
    footage: Footage, telemetry: Telemetry | None, cameras: FrameCameras, reader: TelemetryReader
) -> tuple[str, ...]:
    """Return the uncertain telemetry of a frame that is used nevertheless."""
    if telemetry is None:
        return ("the subtitles have no entry for this frame",) if footage.telemetry else ()
    doubts = [] if cameras.is_given else [*telemetry.lens_doubts]
    if reader.localization_map.origin is not None:
        doubts = [*telemetry.place_doubts, *doubts]
        if telemetry.place is not None and reader(replace(telemetry, gimbal=None)) is None:
            doubts.append(
                f"the position in the telemetry is more than {REACH_M / 1000:.0f} km from the map"
            )
    return tuple(doubts)


def warn_of_far_telemetry(footage: Footage, reader: TelemetryReader) -> None:
    """Warn if no position of the telemetry is near the map."""
    fixes = [item for item in footage.telemetry if item.place is not None]
    if fixes and reader.localization_map.origin is not None and reader(fixes[0]) is None:
        positions = [replace(item, gimbal=None) for item in fixes]
        if all(reader(item) is None for item in positions):
            log.warning(
                "%s has no position within %.0f km of the map: its positions are not used",
                footage.srt,
                REACH_M / 1000,
            )


def _clock(footage: Footage) -> datetime | None:
    """Return the drone's clock at the start of a video, from its subtitles, else from the file."""
    for item in footage.telemetry:
        if item.time is not None:
            return item.time - timedelta(seconds=item.start_s)
    return footage.video.created
