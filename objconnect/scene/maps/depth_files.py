"""Depth and normal maps in the file format of COLMAP's dense stereo.

https://colmap.github.io/format.html#dense-reconstruction
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.files import require_readable

# Largest length of a header.
_HEADER_BYTES = 64


def write_array(path: Path, array: NDArray[np.float32]) -> None:
    """Write an array (C, H, W): the header "width&height&channels&", then float32 row by row.

    Raises:
        InputError: the folder cannot be written, or the disk is full.
    """
    channels, height, width = array.shape
    header = f"{width}&{height}&{channels}&".encode()
    with atomic_write(path) as partial:
        partial.write_bytes(header + np.ascontiguousarray(array, "<f4").tobytes())


def read_array(path: Path, channels: int) -> NDArray[np.float32]:
    """Read an array (C, H, W) of ``channels`` channels.

    Raises:
        InputError: the file is missing or damaged, or has another number of channels.
    """
    require_readable(path, "depth map")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from None
    words = data[:_HEADER_BYTES].split(b"&", 3)
    if len(words) == 4 and all(word.isdigit() for word in words[:3]):
        width, height, planes = (int(word) for word in words[:3])
        start = sum(len(word) + 1 for word in words[:3])
        if planes == channels and len(data) - start == 4 * width * height * channels:
            values = np.frombuffer(data, "<f4", offset=start)
            return values.reshape(channels, height, width).astype(np.float32)
    raise InputError(f"{path} is damaged: remove it and run dense again")
