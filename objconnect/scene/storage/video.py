"""Video files: frames with their times, and writing of a video from pictures.

This is the one module that imports av (PyAV, FFmpeg's libraries), which the extra ``[video]``
installs.
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
# A video that ends so many seconds before it says is cut short.
_CUT_SHORT_S: Final = 1.0
# Codecs of pictures, which film only where there are several.
_OF_PICTURES: Final = ("mjpeg", "png", "bmp", "gif", "webp", "tiff", "jpeg2000", "jpegls")
# A film lasts at least this share of the longest one.
_AS_LONG: Final = 0.9
# Constant rate factor of H.264: smaller is better and larger; at 17 losses are hardly seen.
_QUALITY: Final = "17"


@dataclass(frozen=True)
class Video:
    """What a video file says of itself.

    Attributes:
        width: of the frames as they are shown, pixels.
        height: of the frames as they are shown, pixels.
        rate_hz: frames a second.
        duration_s: seconds; None where the file does not say.
        created: when it was recorded, UTC; None where the file does not say.
        pixel_aspect: width of a pixel for its height, which is 1 where the file does not say.
        unread: kinds of the streams of subtitles and data, such as ``mov_text``, which no one reads
            here.
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
        index: number of frames before it in the file.
        seconds: from the first frame.
        image: (H, W, 3) uint8 RGB, turned as it is shown.
    """

    index: int
    seconds: float
    image: NDArray[np.uint8]


def frame_name(video: str, index: int) -> str:
    """Return the name of a frame among poses, from the name of its video without the ending."""
    return f"{video}-{index:06d}"


def read_video(path: Path) -> Video:
    """Read what a video says of itself, from its first frame.

    Raises:
        InputError: the file cannot be read, is no video or has no frame, its frames are larger than
            64 million pixels, or they are shown turned by an angle that is not a right one.
    """
    with _open(path) as (container, stream):
        first = next(_decode(container, stream, path), None)
        if first is None:
            raise InputError(f"{path} has no frame that can be read: it is empty or damaged")
        height, width = _rotate_for_display(first, path).shape[:2]
        ticks = stream.duration
        duration = float(ticks * stream.time_base) if ticks else None
        aspect = float(stream.sample_aspect_ratio or 0) or 1.0
        created, unread = _creation_time(container), _unread(container)
        return Video(width, height, _rate(stream), duration, created, aspect, unread)


def decode_frames(path: Path, rate_hz: float | None = None) -> Iterator[VideoFrame]:
    """Yield the frames of a video in the order of their times.

    A video that is cut short gives the frames before the cut, and a warning of one line.

    Args:
        path: file of the video.
        rate_hz: frames a second to yield, those nearest to multiples of its inverse; None yields
            all.

    Raises:
        InputError: as for ``read_video``.
    """
    with _open(path) as (container, stream):
        start, due, seconds = None, 0.0, 0.0
        # The frame half a frame's time before a multiple is the nearest to it.
        spare = 0.0 if rate_hz is None else min(0.5 / _rate(stream), 0.25 / rate_hz)
        for index, frame in enumerate(_decode(container, stream, path)):
            at = index / _rate(stream) if frame.time is None else float(frame.time)
            start = at if start is None else start
            seconds = at - start
            if rate_hz is not None:
                if seconds < due - spare:
                    continue
                due = (math.floor((seconds + spare) * rate_hz) + 1) / rate_hz
            yield VideoFrame(index, seconds, _rotate_for_display(frame, path))
        if start is None:
            raise InputError(f"{path} has no frame that can be read: it is empty or damaged")
        stated = float(stream.duration * stream.time_base) if stream.duration else 0.0
        if stated - seconds > _CUT_SHORT_S + 1 / _rate(stream):
            log.warning(
                "%s ends after %.1f of %.1f s: it is cut short, and the frames before are used",
                path,
                seconds,
                stated,
            )


def write_video(path: Path, images: Iterable[NDArray[np.uint8]], rate_hz: float) -> None:
    """Write an MP4 file, with H.264 where FFmpeg has an encoder for it, else with MPEG-4.

    Args:
        path: file to write, whole or not at all where the caller's folder is.
        images: (H, W, 3) uint8 RGB, all of one size with even sides.
        rate_hz: frames a second.

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
                            f"{path}: frames of {size[1]} x {size[0]} have an odd side"
                        )
                    stream.height, stream.width = size[:2]
                    stream.pix_fmt = "yuv420p"
                if image.shape != size:
                    raise InputError(f"{path}: the photographs of a video have several sizes")
                frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
    except (av.error.FFmpegError, OSError) as error:
        raise InputError(f"cannot write {path}: {_reason(error)}") from None


@contextmanager
def _open(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a video and the stream that is the film."""
    av = import_extra("av", "video", _PURPOSE)
    require_readable(path, "video")
    try:
        container = av.open(str(path.absolute()), metadata_errors="replace")
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise InputError(f"{path} is no video that can be read: {_reason(error)}") from None
    with container:
        stream = _film(container, path)
        if stream.width * stream.height > _MOST_PIXELS:
            raise InputError(f"{path} cannot be decoded: its frames are too large")
        yield container, stream


def _film(container: Any, path: Path) -> Any:
    """Return the stream of pictures that is the film.

    Cover pictures and thumbnails are none. Of several films it is the one that lasts longest, then
    the largest, then the one that players show; a warning says which.

    Raises:
        InputError: there is no film.
    """
    if not container.streams.video:
        raise InputError(f"{path} has no pictures: it is no video")
    films = [stream for stream in container.streams.video if not _is_still(container, stream)]
    if not films:
        raise InputError(f"{path} has a picture and no film: give the video that the drone wrote")
    films = [stream for stream in films if stream.codec_context is not None]
    if not films:
        raise InputError(f"{path} cannot be decoded: its codec is unknown")
    longest = max(_seconds(stream) for stream in films)
    film = max(
        films,
        key=lambda stream: (
            _seconds(stream) >= _AS_LONG * longest,
            stream.width * stream.height,
            # Writers mark the first stream where nobody says which: this tells least.
            bool(stream.disposition & stream.disposition.default),
            -stream.index,
        ),
    )
    # A video is opened more than once in a run.
    if len(films) > 1:
        others = ", ".join(str(stream.index) for stream in films if stream is not film)
        _say_once(
            f"{path} has {len(films)} films: stream {film.index} ({film.width} x {film.height}) is "
            f"taken, and {others} left out"
        )
    return film


def _is_still(container: Any, stream: Any) -> bool:
    """Return whether a stream is a picture: a cover, a thumbnail, or a single frame of a codec of
    pictures."""
    disposition = stream.disposition
    flags = ("attached_pic", "timed_thumbnails", "still_image")
    if any(disposition & getattr(disposition, flag, 0) for flag in flags):
        return True
    context = stream.codec_context
    codec = "" if context is None else str(context.name)
    if str(container.format.name).endswith("_pipe") or container.format.name == "image2":
        return True
    return codec in _OF_PICTURES and _count(stream) == 1


def _count(stream: Any) -> float:
    """Return the number of frames that a stream states or its times tell; infinite if unknown."""
    if stream.frames:
        return int(stream.frames)
    rate = stream.average_rate or stream.guessed_rate
    return max(1.0, round(_seconds(stream) * float(rate))) if rate and stream.duration else math.inf


def _seconds(stream: Any) -> float:
    """Return how long a stream lasts, seconds; that of the file where the stream does not say."""
    if stream.duration:
        return float(stream.duration * stream.time_base)
    whole = stream.container.duration
    return 0.0 if whole is None else whole / 1e6


@lru_cache(maxsize=64)
def _say_once(text: str) -> None:
    log.warning("%s", text)


def _decode(container: Any, stream: Any, path: Path) -> Iterator[Any]:
    """Yield decoded frames up to the end of the file, or to the first that is damaged."""
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
            log.warning("%s is damaged after %d frames: those before are used", path, count)
            return
        count += 1
        yield frame


def _rotate_for_display(frame: Any, path: Path) -> NDArray[np.uint8]:
    """Return the picture of a frame, turned as the file says that it is to be shown."""
    if frame.width * frame.height > _MOST_PIXELS:
        raise InputError(f"{path} has frames of {frame.width} x {frame.height} pixels: too large")
    turns, rest = divmod(round(frame.rotation or 0), 90)
    if rest:
        raise InputError(
            f"{path} is shown turned by {frame.rotation} degrees: write it without a rotation"
        )
    # FFmpeg's angle is counter-clockwise, as numpy's.
    return np.ascontiguousarray(np.rot90(frame.to_ndarray(format="rgb24"), turns))


def _rate(stream: Any) -> float:
    """Return frames a second; 30 where the file does not say."""
    rate = stream.average_rate or stream.guessed_rate
    if not rate:
        _say_once(f"{stream.container.name} does not say how many frames it has a second: 30")
    return float(rate) if rate else 30.0


def _unread(container: Any) -> tuple[str, ...]:
    """Return the kinds of the streams in which a drone may have written telemetry."""
    kinds: dict[str, None] = {}
    for stream in container.streams:
        # The clock of a film is a stream of data, too.
        if stream.type in ("subtitle", "data") and "timecode" not in stream.metadata:
            kinds[str(stream.name or stream.type)] = None
    return tuple(kinds)


def _creation_time(container: Any) -> datetime | None:
    try:
        return datetime.fromisoformat(container.metadata["creation_time"])
    except (KeyError, ValueError, TypeError):
        return None


def _reason(error: BaseException) -> str:
    """Return the words of an error of FFmpeg, without its number and the path."""
    reason = getattr(error, "strerror", None) or str(error)
    return str(reason).splitlines()[0] if str(reason) else type(error).__name__
