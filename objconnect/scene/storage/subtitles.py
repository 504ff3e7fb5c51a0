"""Reading and writing of subtitle files (SRT).

Only this module imports srt, which the extra ``[video]`` installs.
"""

from __future__ import annotations

import codecs
import logging
import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Final

from objconnect.scene.errors import InputError
from objconnect.scene.runtime.extras import import_extra
from objconnect.scene.storage.files import require_readable

# Largest file that is read (bytes); an hour of 60 subtitles a second takes 100 MB.
_LARGEST = 1 << 29
# The parser takes cubic time in the digits of a number. After 100 digits, which no value has, a
# replacement character stands for the rest, so that the number is invalid instead of shorter.
_MOST_DIGITS: Final = re.compile(r"([0-9]{100})[0-9]+")
_BYTE_ORDER_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    # Before UTF-16, whose marks are prefixes of these.
    codecs.BOM_UTF32_LE: "utf-32",
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
# A line of times; WebVTT omits hours and appends settings.
_TIME: Final = r"(?:(\d+):)?(\d{1,2}):(\d{1,2})(?:[.,](\d{1,9}))?"
_TIMES: Final = re.compile(rf"^[ \t]*{_TIME}[ \t]*-->[ \t]*{_TIME}(?=\s|$)", re.MULTILINE)
# Encoding without a byte order mark, by the zeros among the first four bytes.
_ZEROS = {
    "x0x0": "utf-16-le",
    "0x0x": "utf-16-be",
    "x000": "utf-32-le",
    "000x": "utf-32-be",
}


@dataclass(frozen=True)
class Subtitle:
    """A text with its start and end times, seconds from the start of the video."""

    start_s: float
    end_s: float
    text: str


def read_subtitles(path: Path) -> list[Subtitle]:
    """Read an SRT file in the order of its times.

    The text is UTF-8, UTF-16, UTF-32 or an encoding that extends ASCII. Bytes that are not valid
    UTF-8 are replaced: they are degree signs and names, never numbers.

    Raises:
        InputError: the file cannot be read, is larger than 512 MiB, or holds no subtitle or an
            invalid time.
    """
    srt = import_extra("srt", "video", "a subtitle file")
    # srt warns of every text that it skips.
    logging.getLogger("srt").setLevel(logging.ERROR)
    require_readable(path, "subtitles")
    try:
        if path.stat().st_size > _LARGEST:
            raise InputError(
                f"{path} is larger than {_LARGEST >> 20} MiB: it is not a subtitle file"
            )
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read subtitles {path}: {error.strerror}") from None
    text = data.decode(_encoding(data), errors="replace")
    text = _MOST_DIGITS.sub("\\1\ufffd", text)
    try:
        items = [
            Subtitle(item.start.total_seconds(), item.end.total_seconds(), item.content)
            # Text between subtitles is skipped, as video players do.
            for item in srt.parse(_normalize_times(_normalize_line_ends(text)), ignore_errors=True)
        ]
    except (ValueError, OverflowError):
        raise InputError(f"{path} holds an invalid time: it is damaged") from None
    if not items:
        raise InputError(f"{path} holds no subtitle: give the SRT file of the video")
    return sorted(items, key=lambda item: item.start_s)


def compose_subtitles(subtitles: Iterable[Subtitle]) -> str:
    """Return the text of an SRT file."""
    srt = import_extra("srt", "video", "a subtitle file")
    items = [
        srt.Subtitle(
            index=index,
            start=timedelta(seconds=subtitle.start_s),
            end=timedelta(seconds=subtitle.end_s),
            content=subtitle.text,
        )
        for index, subtitle in enumerate(subtitles, 1)
    ]
    return str(srt.compose(items, reindex=False))


def _encoding(data: bytes) -> str:
    """Return the encoding of a text that begins with ASCII, from its byte order mark or zeros."""
    for mark, encoding in _BYTE_ORDER_MARKS.items():
        if data.startswith(mark):
            return encoding
    zeros = "".join("0" if byte == 0 else "x" for byte in data[:4])
    return _ZEROS.get(zeros, "utf-8")


def _normalize_line_ends(text: str) -> str:
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _normalize_times(text: str) -> str:
    """Return a text whose times have hours and three digits of milliseconds.

    Fractions are decimal fractions of a second if all have one length, or if one has more than
    three digits. Otherwise they are milliseconds without leading zeros.
    """
    lines = list(_TIMES.finditer(text))
    digits = {len(part) for line in lines for part in line.group(4, 8) if part is not None}
    padded = len(digits) <= 1 or max(digits) > 3

    def time(hours: str | None, minutes: str, seconds: str, fraction: str | None) -> str:
        fraction = fraction or "0"
        fraction = fraction.ljust(3, "0")[:3] if padded else fraction.zfill(3)
        return f"{int(hours or 0):02d}:{minutes:0>2}:{seconds:0>2},{fraction}"

    return _TIMES.sub(
        lambda line: f"{time(*line.groups()[:4])} --> {time(*line.groups()[4:])}", text
    )
