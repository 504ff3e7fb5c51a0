"""Texts compressed by xz: files that end in ``.xz`` are read as what they hold."""

from __future__ import annotations

import lzma
from typing import Final

SUFFIX: Final = ".xz"
"""The end of the name of a compressed file."""

MAGIC: Final = b"\xfd7zXZ\0"
"""The first bytes of every compressed file."""

# What a file of a few kilobytes may become; a larger one would be made to fill the memory (bytes).
_LONGEST: Final = 1 << 26
# The largest window that xz makes by a preset takes less (bytes).
_MOST_MEMORY: Final = 1 << 27


def pack(text: str) -> bytes:
    """Return a UTF-8 text compressed.

    Example:
        >>> unpack(pack("the same again"))
        b'the same again'
    """
    return lzma.compress(text.encode(), preset=6 | lzma.PRESET_EXTREME)


def unpack(content: bytes) -> bytes:
    """Return what was compressed.

    Raises:
        ValueError: the content is not that of one whole xz file, or is longer than 64 MiB.
    """
    reader = lzma.LZMADecompressor(lzma.FORMAT_XZ, _MOST_MEMORY)
    try:
        data = reader.decompress(content, _LONGEST)
    except (lzma.LZMAError, EOFError) as error:
        raise ValueError(f"it is not a whole xz file: {error}") from None
    if not reader.eof or reader.unused_data:
        raise ValueError(f"it is not one whole xz file of at most {_LONGEST >> 20} MiB")
    return data
