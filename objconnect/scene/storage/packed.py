"""Compression of texts with xz, for files ``NAME.xz``."""

from __future__ import annotations

import lzma
from typing import Final

SUFFIX: Final = ".xz"
"""Suffix of a compressed file."""

MAGIC: Final = b"\xfd7zXZ\0"
"""First bytes of a compressed file."""

# Largest decompressed size (bytes), against files that are made to fill the memory.
_LONGEST: Final = 1 << 26
# Memory limit of the decoder (bytes); the presets of xz need less.
_MOST_MEMORY: Final = 1 << 27


def pack(text: str) -> bytes:
    """Compress a text as UTF-8.

    Example:
        >>> unpack(pack("the same again"))
        b'the same again'
    """
    return lzma.compress(text.encode(), preset=6 | lzma.PRESET_EXTREME)


def unpack(content: bytes) -> bytes:
    """Decompress the content of an xz file.

    Raises:
        ValueError: the content is not one whole xz file, or decompresses to more than 64 MiB.
    """
    reader = lzma.LZMADecompressor(lzma.FORMAT_XZ, _MOST_MEMORY)
    try:
        data = reader.decompress(content, _LONGEST)
    except (lzma.LZMAError, EOFError) as error:
        raise ValueError(f"it is not a whole xz file: {error}") from None
    if not reader.eof or reader.unused_data:
        raise ValueError(f"it is not one whole xz file of at most {_LONGEST >> 20} MiB")
    return data
