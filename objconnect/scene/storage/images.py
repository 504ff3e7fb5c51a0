"""Reading of photographs' pixels and sizes."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.storage.files import require_readable

# The exceptions that libraries raise on a damaged image or EXIF.
DAMAGE: Final = (
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
)
# A file of a few bytes may claim any size. Pillow refuses twice the number that it warns of.
_MOST_PIXELS: Final = 2 * (Image.MAX_IMAGE_PIXELS or 0)


def read_rgb(path: Path, camera: Camera | None = None) -> NDArray[np.uint8]:
    """Read a photograph as stored, (H, W, 3) uint8 RGB; an EXIF rotation is not applied.

    Grey values of more than 8 bits are scaled from the range of the photograph, because thermal and
    machine vision cameras use a small part of their range.

    Args:
        path: file to read.
        camera: camera whose size the photograph must have; None for any size.

    Raises:
        InputError: the file is missing, not a regular file, truncated, not an image, of more than
            179 million pixels, or not of the size of ``camera``.
    """
    with open_image(path) as image:
        if image.mode.startswith(("I", "F")):
            pixels = _stretch(np.asarray(image), path)
        else:
            pixels = np.asarray(image.convert("RGB"))
    if camera is not None and pixels.shape[:2] != (camera.height, camera.width):
        raise InputError(
            f"image {path} is {pixels.shape[1]} x {pixels.shape[0]} pixels but its camera is "
            f"{camera.width} x {camera.height}: resize the image or use its own calibration"
        )
    return pixels


def read_grey(path: Path, camera: Camera, bits: int) -> NDArray[Any]:
    """Read a grey image as stored, (H, W) uint8 or uint16.

    Args:
        path: file to read.
        camera: camera whose size the image must have.
        bits: bits of a pixel, 8 or 16.

    Raises:
        InputError: the file is missing, damaged, not a grey image of that many bits, or not of the
            size of ``camera``.
    """
    with open_image(path) as image:
        mode, pixels = image.mode, np.asarray(image)
    if mode not in {8: ("L",), 16: ("I;16", "I")}[bits] or pixels.ndim != 2:
        raise InputError(f"image {path} has the mode {mode}, expected grey of {bits} bits")
    if pixels.shape != (camera.height, camera.width):
        raise InputError(
            f"image {path} is {pixels.shape[1]} x {pixels.shape[0]} pixels but its camera is "
            f"{camera.width} x {camera.height}"
        )
    return pixels.astype(np.uint8 if bits == 8 else np.uint16)


@contextmanager
def open_image(path: Path) -> Iterator[Image.Image]:
    """Open an image file; errors inside the block are reported like those of opening it."""
    if not path.exists() and not path.is_symlink():
        hint = ": the model that names it was made on Windows" if "\\" in path.name else ""
        raise InputError(f"image {path} does not exist{hint}")
    require_readable(path, "image")
    try:
        with Image.open(path) as image:
            yield image
    except InputError:
        raise
    except UnidentifiedImageError:
        raise InputError(f"{path} is not an image that can be read: convert it to JPEG") from None
    except Image.DecompressionBombError:
        raise InputError(
            f"image {path} has more than {_MOST_PIXELS / 1e6:.0f} million pixels: make it smaller"
        ) from None
    except DAMAGE as error:
        raise InputError(f"image {path} is damaged: {error}") from None


def _stretch(grey: NDArray[Any], path: Path) -> NDArray[np.uint8]:
    """Scale grey values (H, W) of any type from their range to 0..255, (H, W, 3) uint8."""
    values = grey.astype(np.float64)
    if not np.isfinite(values).all():
        raise InputError(f"image {path} has values that are not finite: replace them")
    low, high = values.min(), values.max()
    scaled = (values - low) * (255 / (high - low) if high > low else 0.0)
    return np.repeat(np.rint(scaled).astype(np.uint8)[..., None], 3, axis=-1)


def check_photographs(root: Path, cameras: Mapping[str, Camera]) -> None:
    """Check that photographs exist, are whole, and have the size of their cameras.

    COLMAP silently skips unreadable files, and decodes half of a truncated file.

    Args:
        root: folder that the names are relative to.
        cameras: cameras by image name.

    Raises:
        InputError: for the reasons of ``read_rgb``; the message names the first such photograph.
    """
    for name, camera in cameras.items():
        read_rgb(root / name, camera)


def image_size(path: Path) -> tuple[int, int]:
    """Return width and height of a photograph as stored, pixels.

    Raises:
        InputError: the file is missing or not an image.
    """
    with open_image(path) as image:
        return image.size
