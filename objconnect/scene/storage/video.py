"""Reading and writing of video files.

Only this module imports av (PyAV, FFmpeg's libraries), which the extra ``[video]`` installs.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.runtime.extras import import_extra
from objconnect.scene.storage.files import require_readable

log = logging.getLogger(__name__)

# A file of a few bytes may claim any size; 8K has 33 million pixels.
_MOST_PIXELS: Final = 64_000_000
_PURPOSE: Final = "a video"
# A video that ends at least this many seconds before its stated end is truncated.
_CUT_SHORT_S: Final = 1.0
# Codecs of still pictures; such a stream is a video stream only if it has several frames.
_STILL_CODECS: Final = ("mjpeg", "png", "bmp", "gif", "webp", "tiff", "jpeg2000", "jpegls")
# The chosen video stream lasts at least this share of the longest one.
_MIN_DURATION_SHARE: Final = 0.9
# Constant rate factor of H.264, smaller is better; at 17 losses are hardly visible.
_QUALITY: Final = "17"


@dataclass(frozen=True)
class Video:
    """The properties of a video file.

    Attributes:
        width: width of the displayed frames, pixels.
        height: height of the displayed frames, pixels.
        rate_hz: frames per second.
        duration_s: duration, seconds; None if not stated.
        created: time of the recording, UTC; None if not stated.
        pixel_aspect: ratio of a pixel's width to its height as stored, before the display rotation;
            1 if not stated.
        unread: kinds of the subtitle and data streams, such as ``mov_text``, which are not read.
    """

    width: int
    height: int
    rate_hz: float
    duration_s: float | None
    created: datetime | None
    pixel_aspect: float = 1.0
    unread: tuple[str, ...] = ()


@dataclass(frozen=True)
class VideoFrame:
    """A frame of a video.

    Attributes:
        index: index of the frame in the file, from 0.
        seconds: time since the first frame, seconds.
        image: (H, W, 3) uint8 RGB, rotated for display.
    """

    index: int
    seconds: float
    image: NDArray[np.uint8]


def frame_name(video: str, index: int) -> str:
    """Return the name of a frame from the name of its video without the suffix."""
    return f"{video}-{index:06d}"


def read_video(path: Path) -> Video:
    """Read the properties of a video from its header and first frame.

    Raises:
        InputError: the file cannot be read as a video or has no frame, its frames are larger than
            64 million pixels, or their display rotation is not a multiple of 90 degrees.
    """
    with _open(path) as (container, stream):
        first = next(_decode(container, stream, path), None)
        if first is None:
            raise InputError(f"{path} has no frame that can be read: it is empty or damaged")
        height, width = _rotate_for_display(first, path).shape[:2]
        ticks = stream.duration
        duration = float(ticks * stream.time_base) if ticks else None
        aspect = float(stream.sample_aspect_ratio or 0) or 1.0
        created, unread = _creation_time(container), _unread_streams(container)
        return Video(width, height, _rate(stream), duration, created, aspect, unread)


def decode_frames(path: Path, rate_hz: float | None = None) -> Iterator[VideoFrame]:
    """Yield the frames of a video in the order of their times.

    A truncated video yields the frames before the end, with a warning.

    Args:
        path: file of the video.
        rate_hz: frames per second to yield: for each time k / rate_hz the nearest frame. None
            yields all frames.

    Raises:
        InputError: for the reasons of ``read_video``.
    """
    with _open(path) as (container, stream):
        start, next_s, seconds = None, 0.0, 0.0
        # A frame may be this early for a time k / rate_hz: half an interval between frames, within
        # which it is the nearest frame, but at most a quarter of 1 / rate_hz.
        early_s = 0.0 if rate_hz is None else min(0.5 / _rate(stream), 0.25 / rate_hz)
        for index, frame in enumerate(_decode(container, stream, path)):
            time_s = index / _rate(stream) if frame.time is None else float(frame.time)
            start = time_s if start is None else start
            seconds = time_s - start
            if rate_hz is not None:
                if seconds < next_s - early_s:
                    continue
                next_s = (math.floor((seconds + early_s) * rate_hz) + 1) / rate_hz
            yield VideoFrame(index, seconds, _rotate_for_display(frame, path))
        if start is None:
            raise InputError(f"{path} has no frame that can be read: it is empty or damaged")
        stated = float(stream.duration * stream.time_base) if stream.duration else 0.0
        if stated - seconds > _CUT_SHORT_S + 1 / _rate(stream):
            log.warning(
                "%s ends after %.1f of %.1f s: it is cut short and is used up to there",
                path,
                seconds,
                stated,
            )


def write_video(path: Path, images: Iterable[NDArray[np.uint8]], rate_hz: float) -> None:
    """Write an MP4 file with H.264 if FFmpeg has an encoder for it, else with MPEG-4.

    Args:
        path: file to write; it is not written atomically.
        images: (H, W, 3) uint8 RGB, all of one size with even sides.
        rate_hz: frames per second.

    Raises:
        InputError: PyAV is not installed, an image has another size or an odd side, or the file
            cannot be written.
    """
    av = import_extra("av", "video", _PURPOSE)
    codec = "libx264" if "libx264" in av.codecs_available else "mpeg4"
    options = {"crf": _QUALITY} if codec == "libx264" else {"q": "2"}
    size: tuple[int, ...] | None = None
    try:
        with av.open(str(path), "w", format="mp4") as container:
            rate = Fraction(rate_hz).limit_denominator(1001)
            stream = container.add_stream(codec, rate=rate, options=options)
            for image in images:
                if size is None:
                    size = image.shape
                    if size[0] % 2 or size[1] % 2:
                        raise InputError(
                            f"{path}: frames of {size[1]} x {size[0]} have an odd side: resize "
                            "them to even sides"
                        )
                    stream.height, stream.width = size[:2]
                    stream.pix_fmt = "yuv420p"
                if image.shape != size:
                    raise InputError(
                        f"{path}: the frames have several sizes: resize them to one size"
                    )
                frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
    except (av.error.FFmpegError, OSError) as error:
        raise InputError(f"cannot write {path}: {_reason(error)}") from None


@contextmanager
def _open(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a video and choose its video stream."""
    av = import_extra("av", "video", _PURPOSE)
    require_readable(path, "video")
    try:
        container = av.open(str(path.absolute()), metadata_errors="replace")
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read as a video: {_reason(error)}") from None
    with container:
        stream = _choose_stream(container, path)
        if stream.width * stream.height > _MOST_PIXELS:
            raise InputError(
                f"{path} cannot be decoded: its frames are too large: {stream.width} x "
                f"{stream.height} pixels, at most {_MOST_PIXELS / 1e6:.0f} million"
            )
        yield container, stream


def _choose_stream(container: Any, path: Path) -> Any:
    """Return the video stream to read; cover pictures and thumbnails are ignored.

    Of the video streams that last at least 90 % as long as the longest, it is the one with the
    largest frames, and of equally large ones the one marked as default. A warning names the choice.

    Raises:
        InputError: there is no video stream, or none with a known codec.
    """
    if not container.streams.video:
        raise InputError(f"{path} has no pictures: it is not a video")
    streams = [stream for stream in container.streams.video if not _is_still(container, stream)]
    if not streams:
        raise InputError(
            f"{path} has only still pictures and no video stream: give the video that the drone "
            "wrote"
        )
    streams = [stream for stream in streams if stream.codec_context is not None]
    if not streams:
        raise InputError(f"{path} cannot be decoded: its codec is unknown")
    longest = max(_seconds(stream) for stream in streams)
    chosen = max(
        streams,
        key=lambda stream: (
            _seconds(stream) >= _MIN_DURATION_SHARE * longest,
            stream.width * stream.height,
            # Writers mark the first stream by default, so this comes last.
            bool(stream.disposition & stream.disposition.default),
            -stream.index,
        ),
    )
    if len(streams) > 1:
        ignored = ", ".join(str(stream.index) for stream in streams if stream is not chosen)
        size = f"{chosen.width} x {chosen.height}"
        _warn_once(
            f"{path} has {len(streams)} video streams: stream {chosen.index} ({size}) is used, "
            f"stream {ignored} ignored"
        )
    return chosen


def _is_still(container: Any, stream: Any) -> bool:
    """Return whether a stream is a still picture: a cover, a thumbnail or a single picture."""
    disposition = stream.disposition
    flags = ("attached_pic", "timed_thumbnails", "still_image")
    if any(disposition & getattr(disposition, flag, 0) for flag in flags):
        return True
    context = stream.codec_context
    codec = "" if context is None else str(context.name)
    if str(container.format.name).endswith("_pipe") or container.format.name == "image2":
        return True
    return codec in _STILL_CODECS and _count_frames(stream) == 1


def _count_frames(stream: Any) -> float:
    """Return the number of frames of a stream, stated or from its duration; infinite if unknown."""
    if stream.frames:
        return int(stream.frames)
    rate = stream.average_rate or stream.guessed_rate
    return max(1.0, round(_seconds(stream) * float(rate))) if rate and stream.duration else math.inf


def _seconds(stream: Any) -> float:
    """Return the duration of a stream, or else of the file, seconds."""
    if stream.duration:
        return float(stream.duration * stream.time_base)
    whole = stream.container.duration
    return 0.0 if whole is None else whole / 1e6


@lru_cache(maxsize=64)
def _warn_once(text: str) -> None:
    """Warn once, although a run opens a video several times."""
    log.warning("%s", text)


def _decode(container: Any, stream: Any, path: Path) -> Iterator[Any]:
    """Yield decoded frames up to the end of the file or the first damaged frame."""
    av: ModuleType = import_extra("av", "video", _PURPOSE)
    frames = container.decode(stream)
    count = 0
    while True:
        try:
            frame = next(frames)
        except (StopIteration, av.error.EOFError):
            return
        except (av.error.FFmpegError, OSError, ValueError, MemoryError) as error:
            if not count:
                raise InputError(f"{path} cannot be decoded: {_reason(error)}") from None
            log.warning("%s is damaged after %d frames: only these frames are used", path, count)
            return
        count += 1
        yield frame


def _rotate_for_display(frame: Any, path: Path) -> NDArray[np.uint8]:
    """Return the image of a frame, rotated for display."""
    if frame.width * frame.height > _MOST_PIXELS:
        raise InputError(
            f"{path} has frames of {frame.width} x {frame.height} pixels: too large, at most "
            f"{_MOST_PIXELS / 1e6:.0f} million"
        )
    turns, rest = divmod(round(frame.rotation or 0), 90)
    if rest:
        raise InputError(
            f"{path} is displayed rotated by {frame.rotation} degrees: write it without a rotation"
        )
    # FFmpeg's and numpy's angles are counter-clockwise.
    return np.ascontiguousarray(np.rot90(frame.to_ndarray(format="rgb24"), turns))


def _rate(stream: Any) -> float:
    """Return the frames per second; 30 if not stated."""
    rate = stream.average_rate or stream.guessed_rate
    if not rate:
        _warn_once(f"{stream.container.name} does not state its frame rate: 30 is assumed")
    return float(rate) if rate else 30.0


def _unread_streams(container: Any) -> tuple[str, ...]:
    """Return the kinds of the streams that may hold a drone's telemetry."""
    kinds: dict[str, None] = {}
    for stream in container.streams:
        # The time code of a video is also a data stream.
        if stream.type in ("subtitle", "data") and "timecode" not in stream.metadata:
            kinds[str(stream.name or stream.type)] = None
    return tuple(kinds)


def _creation_time(container: Any) -> datetime | None:
    try:
        return datetime.fromisoformat(container.metadata["creation_time"])
    except (KeyError, ValueError, TypeError):
        return None


def _reason(error: BaseException) -> str:
    """Return the message of an FFmpeg error without its number and the path."""
    reason = getattr(error, "strerror", None) or str(error)
    return str(reason).splitlines()[0] if str(reason) else type(error).__name__
