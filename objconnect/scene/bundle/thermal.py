"""Thermal pictures of a session (flight): coding, paths, reading and writing."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import Field, FiniteFloat, model_validator

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.images import read_grey
from objconnect.scene.storage.records import Record

_ZERO_C: Final = 273.15
COUNTS_FOLDER: Final = "thermal"
"""Folder of a session with the pictures of 16 bits."""
PICTURES_FOLDER: Final = "thermal8"
"""Folder of a session with the pictures of 8 bits."""


class Thermal(Record):
    """The coding of a session's thermal pictures, which have the poses of its photographs.

    Attributes:
        kelvin_per_count: brightness temperature of one count of 16 bits, kelvin; 0 counts are 0 K.
        netd_k: standard deviation of the noise at 300 K, kelvin.
        air_c: temperature of the air, degrees Celsius.
        low_c: brightness temperature that is black in 8 bits, degrees Celsius.
        high_c: brightness temperature that is white in 8 bits, degrees Celsius.
    """

    kelvin_per_count: FiniteFloat = Field(gt=0)
    netd_k: FiniteFloat = Field(ge=0)
    air_c: FiniteFloat
    low_c: FiniteFloat
    high_c: FiniteFloat

    @model_validator(mode="after")
    def _check_range(self) -> Thermal:
        if not self.low_c < self.high_c:
            raise ValueError("low_c must be below high_c")
        return self

    def kelvin(self, counts: NDArray[np.uint16]) -> NDArray[np.float32]:
        """Return the brightness temperatures of counts of any shape, kelvin."""
        return np.asarray(counts * self.kelvin_per_count, np.float32)

    def stretch(self, counts: NDArray[np.uint16]) -> NDArray[np.uint8]:
        """Return grey values of counts of any shape: black at ``low_c``, white at ``high_c``."""
        share = (counts * self.kelvin_per_count - _ZERO_C - self.low_c) / (self.high_c - self.low_c)
        return np.asarray(np.rint(255 * np.clip(share, 0, 1)), np.uint8)


def counts_path(root: Path, name: str) -> Path:
    """Return the picture of 16 bits that belongs to a photograph.

    Args:
        root: folder that the name is relative to.
        name: name of the photograph, SESSION/images/NNNNNN.jpg.
    """
    image = root / name
    return image.parents[1] / COUNTS_FOLDER / f"{image.stem}.png"


def picture_path(root: Path, name: str) -> Path:
    """Return the picture of 8 bits that belongs to a photograph; see ``counts_path``."""
    image = root / name
    return image.parents[1] / PICTURES_FOLDER / f"{image.stem}.png"


def write_thermal(root: Path, name: str, counts: NDArray[np.uint16], record: Thermal) -> None:
    """Write both thermal pictures of a photograph from counts (H, W).

    Raises:
        InputError: the folder cannot be written, or the disk is full.
    """
    pictures: tuple[tuple[Path, NDArray[Any]], ...] = (
        (counts_path(root, name), counts),
        (picture_path(root, name), record.stretch(counts)),
    )
    for path, pixels in pictures:
        with atomic_write(path) as partial:
            Image.fromarray(pixels).save(partial, "PNG", compress_level=3)


def read_thermal(root: Path, name: str, camera: Camera, record: Thermal) -> NDArray[np.float32]:
    """Read the thermal picture of a photograph as brightness temperatures (H, W), kelvin.

    Raises:
        InputError: the picture is missing, damaged, or of another size or bit depth than stated.
    """
    return record.kelvin(read_grey(counts_path(root, name), camera, bits=16))


def check_thermal(root: Path, name: str, camera: Camera, record: Thermal) -> None:
    """Check that both thermal pictures of a photograph are whole, and that they agree.

    Raises:
        InputError: a picture is missing, damaged, of another size or bit depth than stated, or the
            two differ.
    """
    counts = read_grey(counts_path(root, name), camera, bits=16)
    path = picture_path(root, name)
    if not np.array_equal(read_grey(path, camera, bits=8), record.stretch(counts)):
        raise InputError(
            f"{path} does not agree with {counts_path(root, name)}, stretched from "
            f"{record.low_c:g} to {record.high_c:g} degrees Celsius: render the scene again"
        )
