"""Compression of texts with xz, for files ``NAME.xz``."""

from __future__ import annotations

import lzma
from typing import Final

XZ_SUFFIX: Final = ".xz"
"""Suffix of a compressed file."""

XZ_MAGIC: Final = b"\xfd7zXZ\0"
"""First bytes of a compressed file."""

# Largest decompressed size (bytes), against files that are made to fill the memory.
_MAX_BYTES: Final = 1 << 26
# Memory limit of the decoder (bytes); the presets of xz need less.
_MAX_MEMORY: Final = 1 << 27


def pack(text: str) -> bytes:
    """Compress a text as UTF-8.

    Examples:
        >>> unpack(pack("the same again"))
        b'the same again'
    """
    return lzma.compress(text.encode(), preset=6 | lzma.PRESET_EXTREME)


def unpack(content: bytes) -> bytes:
    """Decompress the content of an xz file.

    Raises:
        ValueError: the content is not one whole xz file, or decompresses to more than 64 MiB.
    """
    reader = lzma.LZMADecompressor(lzma.FORMAT_XZ, _MAX_MEMORY)
    try:
        data = reader.decompress(content, _MAX_BYTES)
    except (lzma.LZMAError, EOFError) as error:
        raise ValueError(f"it is not a whole xz file: {error}") from None
    if not reader.eof and len(data) >= _MAX_BYTES:
        raise ValueError(f"its decompressed size must be at most {_MAX_BYTES >> 20} MiB")
    if not reader.eof or reader.unused_data:
        raise ValueError("it is not one whole xz file")
    return data
