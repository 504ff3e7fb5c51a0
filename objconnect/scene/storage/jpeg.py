"""JPEG files without metadata: the picture alone, with the bytes of its compressed pixels."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from objconnect.scene.errors import InputError
from objconnect.scene.storage.files import require_readable

# Markers of ITU-T T.81 (1992), table B.1.
_START, _SCAN, _END = b"\xff\xd8", 0xDA, b"\xff\xd9"
_APPLICATIONS: Final = range(0xE0, 0xF0)
_COMMENT: Final = 0xFE
# Segments that are needed to decode the picture: JFIF, and Adobe's transform of colours.
_DECODING_SEGMENTS: Final = ((0xE0, b"JFIF\0"), (0xEE, b"Adobe"))


def read_bare_jpeg(path: Path) -> bytes:
    """Read a JPEG file without EXIF, XMP, comments and whatever follows the picture.

    Raises:
        InputError: the file is missing, damaged or not a JPEG file.
    """
    require_readable(path, "photograph")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read photograph {path}: {error.strerror}") from None
    bare = _strip(data)
    if bare is None:
        raise InputError(
            f"{path} is not a JPEG file, or is damaged: only the metadata of JPEG files is removed"
        )
    return bare


def _strip(data: bytes) -> bytes | None:
    """Return the bytes without metadata; None if they are not a JPEG file."""
    if not data.startswith(_START):
        return None
    segments, offset = [_START], len(_START)
    while offset + 4 <= len(data) and data[offset] == 0xFF:
        marker, length = data[offset + 1], int.from_bytes(data[offset + 2 : offset + 4], "big")
        if marker == _SCAN:
            # Within compressed pixels, a byte 0xFF is never followed by the end's second byte.
            end = data.find(_END, offset)
            return None if end < 0 else b"".join([*segments, data[offset : end + len(_END)]])
        segment = data[offset : offset + 2 + length]
        if not _is_metadata(marker, segment[4:]):
            segments.append(segment)
        offset += 2 + length
    return None


def _is_metadata(marker: int, content: bytes) -> bool:
    if marker == _COMMENT:
        return True
    is_for_decoding = any(
        marker == kind and content.startswith(words) for kind, words in _DECODING_SEGMENTS
    )
    return marker in _APPLICATIONS and not is_for_decoding
