"""The images of a sequence in the order of their times: frames of a video, or photographs."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.telemetry import Telemetry
from objconnect.localization.pipeline.cameras import CameraSource
from objconnect.localization.pipeline.footage import Footage, FrameCameras, Timing
from objconnect.localization.pipeline.photographs import PhotographReader, Place
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic
from objconnect.scene.geometry.gimbal import gimbal_pose
from objconnect.scene.localizer import Prior, Query
from objconnect.scene.quantities.coordinate_order import REACH_M
from objconnect.scene.storage.video import decode_frames, frame_name

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Shot:
    """An image of a sequence.

    Attributes:
        name: name among the poses.
        seconds: from the start of the sequence; None where that is not known.
        time: clock of the drone; None where that is not known.
        query: the image with what the aircraft knows; None where it cannot be read.
        source: where the camera of the query comes from; None without a query.
        reason: why it cannot be read.
        gps: position that a receiver measured, in the map's frame; None without one.
        doubts: what the image, or the telemetry of a frame, does not say for sure.
    """

    name: str
    seconds: float | None
    time: datetime | None
    query: Query | None
    source: CameraSource | None = None
    reason: str = ""
    gps: Prior | None = None
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class TelemetryReader:
    """Turns telemetry into priors of a map.

    Attributes:
        place: the map.
        gps_sigma_m: standard deviation of positions per axis, metres.
        gimbal_sigma_deg: standard deviation of the gimbal's attitudes per axis, degrees.
        undulation_m: height of the geoid above the ellipsoid; None leaves altitudes unknown.
    """

    place: Place
    gps_sigma_m: float
    gimbal_sigma_deg: float
    undulation_m: float | None

    def __call__(self, said: Telemetry | None) -> Prior | None:
        """Return what telemetry says in the map's frame; None where it says neither position nor
        attitude, or the position is not near the map."""
        if said is None:
            return None
        prior = self._position(said)
        if said.gimbal is None:
            return prior
        if prior is None:
            prior = Prior(self._middle(), np.full(3, np.inf))
        return replace(
            prior,
            cam_from_world_rotation=gimbal_pose(*said.gimbal).rotation.numpy(),
            attitude_sigma_deg=self.gimbal_sigma_deg,
        )

    def _position(self, said: Telemetry) -> Prior | None:
        origin = self.place.origin
        if said.place is None or origin is None:
            return None
        sigma = np.full(3, self.gps_sigma_m)
        if said.abs_alt is not None and self.undulation_m is not None:
            altitude = said.abs_alt + self.undulation_m
            position = enu_from_geodetic(Geodetic(*said.place, altitude), origin)
        else:
            # The height of the map's cameras stands where the altitude is unknown.
            position = enu_from_geodetic(Geodetic(*said.place, origin.altitude), origin)
            position[2], sigma[2] = self._middle()[2], np.inf
        if np.hypot(*position[:2]) > REACH_M:
            return None
        return Prior(position, sigma)

    def _middle(self) -> NDArray[np.float64]:
        """Return the middle of the map's cameras, (3,) metres."""
        images = self.place.sparse_map.images.values()
        return np.asarray(np.median([image.pose.centre().numpy() for image in images], axis=0))


def frames_of(
    footage: Footage, cameras: FrameCameras, telemetry: TelemetryReader
) -> Iterator[Shot]:
    """Yield the frames of a video at its rate, with the priors of its telemetry."""
    clock, timing = _clock(footage), Timing.of(footage.flight, footage.video)
    for frame in decode_frames(footage.path, footage.rate_hz):
        said = timing.said(footage.flight, frame)
        name = frame_name(footage.path.stem, frame.index)
        time = None if clock is None else clock + timedelta(seconds=frame.seconds)
        calibration = cameras.of(said)
        if calibration is None:
            reason = f"{footage.srt} does not tell the focal length or zoom: give --camera"
            doubts = _doubts(footage, said, cameras, telemetry)
            yield Shot(name, frame.seconds, time, None, None, reason, doubts=doubts)
            continue
        gps = telemetry(said)
        doubts = _doubts(footage, said, cameras, telemetry)
        query = Query(name, frame.image, calibration.camera, gps)
        yield Shot(name, frame.seconds, time, query, calibration.source, gps=gps, doubts=doubts)


def _doubts(
    footage: Footage, said: Telemetry | None, cameras: FrameCameras, telemetry: TelemetryReader
) -> tuple[str, ...]:
    """Return what telemetry does not say of a frame for sure, of what is taken from it."""
    if said is None:
        return ("the subtitles say nothing of this frame",) if footage.flight else ()
    doubts = [] if cameras.is_given else [*said.lens_doubts]
    if telemetry.place.origin is not None:
        doubts = [*said.place_doubts, *doubts]
        if said.place is not None and telemetry(replace(said, gimbal=None)) is None:
            doubts.append(f"its position is more than {REACH_M / 1000:.0f} km from the map")
    return tuple(doubts)


def warn_of_far_telemetry(footage: Footage, telemetry: TelemetryReader) -> None:
    """Warn where no position of the telemetry lies near the map."""
    fixes = [said for said in footage.flight if said.place is not None]
    if fixes and telemetry.place.origin is not None and telemetry(fixes[0]) is None:
        places = [replace(said, gimbal=None) for said in fixes]
        if all(telemetry(said) is None for said in places):
            log.warning(
                "%s has positions, and none within %.0f km of the map: they are not used",
                footage.srt,
                REACH_M / 1000,
            )


def photographs_of(
    paths: Mapping[str, Path], reader: PhotographReader, rate_hz: float | None
) -> Iterator[Shot]:
    """Yield photographs in the order of their times, which are those of EXIF, or of a rate.

    Args:
        paths: photographs by name.
        reader: makes them queries.
        rate_hz: photographs a second; they are then in the order of their names.

    Raises:
        InputError: there is no rate, and a photograph does not tell when it was taken, or two tell
            the same time.
    """
    times: dict[str, datetime | None] = {}
    for name, path in paths.items():
        with suppress(InputError, OSError):
            times[name] = reader.exif(path).time
    if rate_hz is not None:
        seconds = {name: index / rate_hz for index, name in enumerate(paths)}
    else:
        seconds = _seconds(times)
    # Those that cannot be read have no time: they come last.
    for name in sorted(paths, key=lambda name: seconds.get(name, math.inf)):
        query, source, reason, gps = None, None, "", None
        doubts: tuple[str, ...] = ()
        try:
            photograph = reader.read(name, paths[name])
            gps, doubts = reader.gps(photograph.exif), reader.doubts(photograph.exif)
            query, source = photograph.query, photograph.calibration.source
            if photograph.calibration.others:
                query = None
                told = f" ({'; '.join(photograph.exif.lens_doubts)})" if doubts else ""
                reason = f"nothing tells the focal length of {paths[name]}{told}: give --camera"
        except InputError as error:
            reason = str(error)
        except OSError as error:
            reason = f"cannot read {paths[name]}: {error.strerror}"
        yield Shot(name, seconds.get(name), times.get(name), query, source, reason, gps, doubts)


def _seconds(times: Mapping[str, datetime | None]) -> dict[str, float]:
    """Return seconds from the first photograph.

    Raises:
        InputError: a photograph has no time, or two have the same.
    """
    known = {name: time.replace(tzinfo=None) for name, time in times.items() if time is not None}
    hint = "give --rate, photographs a second, and they are taken in the order of their names"
    for name in times:
        if name not in known:
            raise InputError(f"photograph {name} does not tell when it was taken: {hint}")
    ordered = sorted(known, key=lambda name: known[name])
    for before, name in pairwise(ordered):
        if known[before] == known[name]:
            raise InputError(f"photographs {before} and {name} tell the same time: {hint}")
    return {name: (known[name] - known[ordered[0]]).total_seconds() for name in ordered}


def _clock(footage: Footage) -> datetime | None:
    """Return the drone's clock at the start of a video, from its subtitles, else from the file."""
    for said in footage.flight:
        if said.time is not None:
            return said.time - timedelta(seconds=said.start_s)
    return footage.video.created
