"""A video with telemetry in its subtitles: the camera and the telemetry of each frame."""

from __future__ import annotations

import logging
from bisect import bisect_right
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Final

from objconnect.ingestion.telemetry import Telemetry, find_telemetry, read_telemetry
from objconnect.localization.pipeline.cameras import Calibration, CameraSource, calibration_of
from objconnect.localization.pipeline.localization_map import LocalizationMap
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import MODELS, Camera
from objconnect.scene.quantities.coordinate_order import Pair
from objconnect.scene.quantities.film_lens import SAME_LENS
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.storage.exif import Exif
from objconnect.scene.storage.video import Video, VideoFrame, read_video

log = logging.getLogger(__name__)

# Endings of files of subtitles beside a video.
_SIDECARS: Final = (".SRT", ".srt", ".Srt")
# Width of 35 mm film, to which equivalent focal lengths refer.
_FILM_MM: Final = 36.0
# Frame rates, numbers of frames and durations agree if they differ relatively by less than this.
_SAME_RATE: Final = 0.05
# Largest deviation from 1 of the aspect ratio of square pixels.
_SQUARE: Final = 0.005
# Least relative change of the focal length that is a zoom.
_MIN_ZOOM_CHANGE: Final = 0.005


@dataclass(frozen=True)
class Footage:
    """A video with its telemetry, to be localized.

    Attributes:
        path: file of the video.
        video: metadata of the video.
        srt: file of the subtitles; None without subtitles.
        telemetry: entries of the subtitles; empty without subtitles.
        rate_hz: number of frames to localize per second.
    """

    path: Path
    video: Video
    srt: Path | None
    telemetry: Sequence[Telemetry]
    rate_hz: float

    @staticmethod
    def open(
        path: Path,
        srt: Path | None,
        rate_hz: float,
        localization_map: LocalizationMap | None = None,
    ) -> Footage:
        """Read the metadata of a video and the telemetry of its subtitles.

        Args:
            path: file of the video.
            srt: file of its subtitles; None for the file of the same name beside it, if it exists.
            rate_hz: number of frames to localize per second.
            localization_map: map that resolves ambiguities of the telemetry, such as the order of
                coordinates.

        Raises:
            InputError: the video or the subtitles cannot be read.
        """
        video = read_video(path)
        if srt is None:
            sidecars = (path.with_suffix(ending) for ending in _SIDECARS)
            srt = next((file for file in sidecars if file.is_file()), None)
        if srt is None and video.unread:
            log.warning(
                "%s has subtitles or data (%s) that are not read: give --srt if they are telemetry",
                path,
                ", ".join(map(for_terminal, video.unread)),
            )
        telemetry = (
            []
            if srt is None
            else read_telemetry(
                srt, _map_position(localization_map), _map_focals(localization_map, video)
            )
        )
        return Footage(path, video, srt, telemetry, rate_hz)

    @property
    def count(self) -> int:
        """Return the approximate number of frames to localize."""
        rate_hz = min(self.rate_hz, self.video.rate_hz)
        return max(1, round((self.video.duration_s or 0.0) * rate_hz))


def _map_position(localization_map: LocalizationMap | None) -> Pair | None:
    """Return latitude and longitude of a map's origin, degrees; None if unknown."""
    if localization_map is None or localization_map.origin is None:
        return None
    return localization_map.origin.latitude, localization_map.origin.longitude


def _map_focals(localization_map: LocalizationMap | None, video: Video) -> list[float]:
    """Return the 35 mm equivalent focal lengths (mm) of the map's cameras of a video's aspect."""
    cameras: Collection[Camera] = () if localization_map is None else localization_map.cameras
    aspect = video.width / video.height
    return [
        _equivalent_focal(camera)
        for camera in cameras
        if abs(camera.width / camera.height / aspect - 1) < SAME_LENS
    ]


def _equivalent_focal(camera: Camera) -> float:
    return _FILM_MM * camera.focal[0] / max(camera.width, camera.height)


@dataclass(frozen=True)
class FrameCameras:
    """The cameras of a video's frames; zoom changes the focal length from frame to frame.

    Attributes:
        base: camera without digital zoom.
        focal_mm: 35 mm equivalent focal length (mm) that the telemetry states for ``base``; None if
            unknown.
        constant_zoom: factor on the focal length of ``base`` for all frames; None if it changes or
            is unknown.
        is_given: whether the user gives the camera, which is then used for all frames.
    """

    base: Calibration
    focal_mm: float | None = None
    constant_zoom: float | None = 1.0
    is_given: bool = False

    def of(self, telemetry: Telemetry | None) -> Calibration | None:
        """Return the camera of a frame; None if its focal length is unknown."""
        if self.is_given:
            return self.base
        scale = self.constant_zoom
        if telemetry is not None and self.constant_zoom is None:
            scale = _scale(telemetry, self.focal_mm)
        if scale is None or abs(scale - 1) < 1e-9:
            return None if scale is None else self.base
        source = self.base.source
        source = CameraSource.SCALED if source is CameraSource.MAP else source
        return Calibration(_apply_zoom(self.base.camera, scale), source)


def cameras_of_frames(
    footage: Footage, camera: Camera | None, localization_map: LocalizationMap
) -> FrameCameras:
    """Return the cameras of a video's frames.

    If the user gives no camera, the map's camera of the frames' size and focal length is used. If
    there is none, the map's camera of the same lens and another size is scaled, or else the camera
    is a pinhole with the telemetry's focal length. Zoom in the telemetry multiplies that length.

    Raises:
        InputError: the given camera has another size, or the focal length is unknown.
    """
    size = (footage.video.width, footage.video.height)
    subject = f"{footage.path} is {size[0]} x {size[1]} pixels and "
    hint = ": give its calibration with --camera 'MODEL width height params...'"
    if camera is not None:
        if (camera.width, camera.height) != size:
            raise InputError(
                f"{subject}the camera of --camera {camera.width} x {camera.height}: give one of "
                "the video's size"
            )
        _warn_of_zoom(footage)
        return FrameCameras(Calibration(camera, CameraSource.GIVEN), is_given=True)
    aspect = footage.video.pixel_aspect
    if abs(aspect - 1) > _SQUARE:
        raise InputError(f"{subject}its pixels are {aspect:.3f} times as wide as high{hint}")
    focal = _reference_focal(footage.telemetry, _map_focals(localization_map, footage.video))
    base = calibration_of(size, Exif(None, None, focal_35mm=focal), localization_map.cameras)
    if base.source is CameraSource.ESTIMATED:
        zooms = [item.zoom for item in footage.telemetry]
        missing = "focal length" if all(zooms) else "focal length and zoom (dzoom_ratio)"
        raise InputError(f"{subject}has no {missing}{hint}")
    scales = {_scale(item, focal) for item in footage.telemetry} or {1.0}
    if scales == {None} and all(item.zoom is None for item in footage.telemetry):
        if base.source is not CameraSource.MAP:
            raise InputError(f"{subject}has no zoom (dzoom_ratio){hint}")
        log.warning("%s: the zoom is unknown; the map's camera is used without zoom", footage.srt)
        scales = {1.0}
    _warn_of_another_lens(footage, focal, base, localization_map)
    return FrameCameras(base, focal, scales.pop() if len(scales) == 1 else None)


def _reference_focal(telemetry: Sequence[Telemetry], lenses: Sequence[float]) -> float | None:
    """Return the focal length in the telemetry that is nearest to one of the map's cameras.

    If several are equally near, or none is near, the most frequent one is returned; None if the
    telemetry has no focal length. Focal lengths are 35 mm equivalent (mm); ``lenses`` are those of
    the map's cameras.
    """
    focals = Counter(item.focal_mm for item in telemetry if item.focal_mm is not None)
    if not focals:
        return None

    def mismatch(focal: float) -> float:
        least = min((max(focal / lens, lens / focal) - 1 for lens in lenses), default=SAME_LENS)
        return min(least, SAME_LENS)

    return min(focals, key=lambda focal: (mismatch(focal), -focals[focal]))


def _scale(telemetry: Telemetry, focal_mm: float | None) -> float | None:
    """Return a frame's focal length, zoom included, divided by ``focal_mm``; None if unknown."""
    if focal_mm is None or telemetry.zoom is None:
        return telemetry.zoom
    return None if telemetry.focal_mm is None else telemetry.zoom * telemetry.focal_mm / focal_mm


def _apply_zoom(camera: Camera, scale: float) -> Camera:
    """Return the camera with a digital zoom, which enlarges the middle of the picture."""
    middle = {"cx": camera.width / 2, "cy": camera.height / 2}
    params = []
    for name, value in zip(MODELS[camera.model], camera.params, strict=True):
        if name in middle:
            value = middle[name] + scale * (value - middle[name])
        params.append(scale * value if name in ("f", "fx", "fy") else value)
    return replace(camera, params=tuple(params))


def _warn_of_zoom(footage: Footage) -> None:
    """Warn if one camera is given for frames of several focal lengths."""
    focals = [item.effective_mm for item in footage.telemetry if item.effective_mm is not None]
    if focals and max(focals) > (1 + _MIN_ZOOM_CHANGE) * min(focals):
        log.warning(
            "%s states a zoom from %.1f to %.1f mm, but --camera is used for all frames",
            footage.srt,
            min(focals),
            max(focals),
        )


def _warn_of_another_lens(
    footage: Footage, focal: float | None, base: Calibration, localization_map: LocalizationMap
) -> None:
    """Warn if the map has a camera of the frames' size and telemetry names another lens."""
    same_size = [
        camera
        for camera in localization_map.cameras
        if (camera.width, camera.height) == (footage.video.width, footage.video.height)
    ]
    if focal is not None and same_size and base.source is not CameraSource.MAP:
        log.warning(
            "%s has a focal length of %.1f mm, which is used; the map's camera of this size has "
            "%.1f mm: give --camera if the map's is right",
            footage.srt,
            focal,
            _equivalent_focal(same_size[0]),
        )


@dataclass(frozen=True)
class Timing:
    """The assignment of subtitles to the frames of a video.

    Attributes:
        by_frame: whether subtitles are assigned to frames by frame number, as in slow motion,
            instead of by time.
        is_known: whether frame numbers or times of the subtitles fit the video.
    """

    by_frame: bool = False
    is_known: bool = True

    @staticmethod
    def of(telemetry: Sequence[Telemetry], video: Video) -> Timing:
        """Compare the times and frame numbers of the subtitles with those of the video.

        If frame numbers and times of the subtitles imply the video's frame rate, times are used.
        Otherwise frame numbers are used if the last number fits the end of the video, or times if
        the last time fits it. If neither fits, the subtitles are ignored with a warning.
        """
        numbered = [(item.frame, item.start_s) for item in telemetry if item.frame is not None]
        ascending = all(first[0] < second[0] for first, second in pairwise(numbered))
        if len(numbered) < max(2, len(telemetry)) or not ascending or video.duration_s is None:
            return Timing()
        frames, seconds = numbered[-1][0] - numbered[0][0], numbered[-1][1] - numbered[0][1]
        # Times of subtitles are whole milliseconds.
        if frames <= 0 or seconds < 0.1 or _is_close(frames / seconds, video.rate_hz):
            return Timing()
        if _is_close(numbered[-1][0], video.duration_s * video.rate_hz):
            return Timing(by_frame=True)
        if _is_close(telemetry[-1].end_s, video.duration_s):
            return Timing()
        log.warning(
            "the subtitles have %.1f frames a second and the video %.1f: they cannot be assigned "
            "to frames and are not used",
            frames / seconds,
            video.rate_hz,
        )
        return Timing(is_known=False)

    def telemetry_of(self, telemetry: Sequence[Telemetry], frame: VideoFrame) -> Telemetry | None:
        """Return the telemetry of a frame; None if the subtitles have none for it."""
        if not self.is_known:
            return None
        if not self.by_frame:
            return find_telemetry(telemetry, frame.seconds)
        row = bisect_right(telemetry, frame.index + 1, key=lambda item: item.frame or 0) - 1
        return telemetry[row] if row >= 0 else None


def _is_close(first: float, second: float) -> bool:
    return abs(first / second - 1) < _SAME_RATE if second else False
