"""Export of each flight as a drone's recording: ``SESSION.MP4``, with telemetry in ``SESSION.SRT``.

The subtitles have the form of recent DJI drones. Position and gimbal are noisy measurements
(priors); ``abs_alt`` is the altitude above the ellipsoid, because scenes have no sea level.
``SESSION-poses.txt`` holds the true poses, lines "name qw qx qy qz tx ty tz" of cam_from_world with
the frame names of ``localize --video``; ``SESSION-times.csv`` holds the seconds of each frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.frames import Frames
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import geodetic_from_enu
from objconnect.scene.geometry.gimbal import gimbal_angles
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.names import quote_name
from objconnect.scene.storage.subtitles import Subtitle, compose_subtitles
from objconnect.scene.storage.video import frame_name, write_video

# Largest deviation of an interval between frames from the median, as a share of the median.
_MAX_DEVIATION: Final = 0.05
# Smallest and largest interval between frames, seconds.
_MIN_INTERVAL_S: Final = 1 / 240
_MAX_INTERVAL_S: Final = 60
# Width of the sensor to which DJI's focal lengths refer, millimetres.
_SENSOR_MM: Final = 36


def write(scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path) -> None:
    """Write video, subtitles, true poses and times of each session; see ``formats.Writer``.

    Raises:
        InputError: PyAV or srt is not installed, a session has fewer than two photographs, they
            have no time or no constant rate, or their sizes differ or have an odd side.
    """
    for name, frames in sessions.items():
        rate_hz = _rate(name, frames)
        (folder / f"{name}.SRT").write_text(
            compose_subtitles(_subtitles(scene, frames, rate_hz)), "utf-8"
        )
        write_video(folder / f"{name}.MP4", _pictures(scene, frames), rate_hz)
        names = [frame_name(name, index) for index in range(len(frames))]
        lines = [
            f"{quote_name(frame)} {' '.join(repr(value) for value in numbers)}\n"
            for frame, numbers in zip(names, _pose_rows(frames.poses), strict=True)
        ]
        # The header differs from that of results files, so that 'localize' does not replace it.
        header = "# true poses: name qw qx qy qz tx ty tz  (world to camera, metres)\n"
        (folder / f"{name}-poses.txt").write_text(header + "".join(lines), "utf-8")
        seconds = (f"{frame},{index / rate_hz:.6f}\n" for index, frame in enumerate(names))
        (folder / f"{name}-times.csv").write_text("name,seconds\n" + "".join(seconds), "utf-8")


def _rate(session: str, frames: Frames) -> float:
    """Return the frame rate of a session, from 1 per minute to 240 per second.

    Raises:
        InputError: there are fewer than two photographs, or they have no times or no constant rate
            in this range.
    """
    if len(frames) < 2:
        raise InputError(
            f"session {session} has {len(frames)} photograph: choose a session with at least two"
        )
    steps = np.diff(frames.time)
    if not np.isfinite(steps).all():
        raise InputError(
            f"session {session} has photographs without a time: choose a session whose "
            "photographs all have one"
        )
    if (steps <= 0).any():
        raise InputError(
            f"the photographs of session {session} are not in the order of their times: choose a "
            "session in this order"
        )
    step = float(np.median(steps))
    if np.abs(steps - step).max() > _MAX_DEVIATION * step:
        raise InputError(
            f"the photographs of session {session} were not taken at one rate: choose a session "
            f"whose intervals differ from their median by at most {_MAX_DEVIATION:.0%}"
        )
    if not _MIN_INTERVAL_S <= step <= _MAX_INTERVAL_S:
        raise InputError(
            f"the photographs of session {session} were taken {step:g} s apart: choose a session "
            f"with {_MIN_INTERVAL_S:.3f} to {_MAX_INTERVAL_S} s between photographs"
        )
    return float((len(frames) - 1) / (frames.time[-1] - frames.time[0]))


def _pictures(scene: Scene, frames: Frames) -> Iterator[NDArray[np.uint8]]:
    for name, camera in zip(frames.names, frames.cameras, strict=True):
        yield read_rgb(scene.images_root / name, camera)


def _pose_rows(poses: Pose) -> list[list[float]]:
    rows: list[list[float]] = np.hstack([poses.quaternion(), poses.translation]).tolist()
    return rows


def _subtitles(scene: Scene, frames: Frames, rate_hz: float) -> Iterator[Subtitle]:
    """Yield a subtitle for each frame in DJI's form."""
    for k in range(len(frames)):
        start_s, end_s = k / rate_hz, (k + 1) / rate_hz
        clock = datetime.fromtimestamp(float(frames.time[k]), UTC).isoformat(" ", "milliseconds")
        text = (
            f'<font size="28">FrameCnt: {k + 1}, DiffTime: {1000 / rate_hz:.0f}ms\n'
            f"{clock[:23]}\n"
            f"[focal_len: {_SENSOR_MM * frames.cameras[k].focal[0] / frames.cameras[k].width:.2f}] "
            f"{_position(scene, frames, k)}{_gimbal(frames, k)}</font>"
        )
        yield Subtitle(start_s, end_s, text)


def _position(scene: Scene, frames: Frames, k: int) -> str:
    """Return the fields of the measured position; zeros if there is none."""
    origin = scene.manifest.origin
    if not frames.has_gps[k]:
        return "[latitude: 0.000000] [longitude: 0.000000] "
    gps = geodetic_from_enu(frames.gps_prior[k], origin)
    return (
        f"[latitude: {gps.latitude:.6f}] [longitude: {gps.longitude:.6f}] "
        f"[rel_alt: {gps.altitude - origin.altitude:.3f} abs_alt: {gps.altitude:.3f}] "
    )


def _gimbal(frames: Frames, k: int) -> str:
    if not frames.has_attitude[k]:
        return ""
    yaw, pitch, roll = gimbal_angles(Pose.from_quaternion(frames.attitude_prior[k], np.zeros(3)))
    return f"[gb_yaw: {yaw:.1f} gb_pitch: {pitch:.1f} gb_roll: {roll:.1f}] "
