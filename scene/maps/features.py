"""Local features of images, in memory and on disk."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scene.errors import HDF5_DAMAGE, InputError
from scene.storage.files import require_readable, written_whole
from scene.storage.hdf5 import array, attribute, group, groups, set_text

# Of the group of an image whose name holds what stands for a slash in the names of groups.
_NAME = "name"


@dataclass(frozen=True)
class Features:
    """Keypoints and descriptors of one image.

    Attributes:
        xy: (N, 2) float32 COLMAP pixels.
        scale: (N,) float32 pixels.
        descriptors: (N, D) as their extractor makes them: vectors of float32 or uint8 (COLMAP's
            RootSIFT is 128 uint8, of length 512), or bits packed in uint8.
    """

    xy: NDArray[np.float32]
    scale: NDArray[np.float32]
    descriptors: NDArray[Any]


def unit_descriptors(descriptors: NDArray[Any]) -> Tensor:
    """Descriptors that are vectors as (N, D) float32 of unit length, ready to match."""
    return torch.nn.functional.normalize(torch.from_numpy(descriptors).float(), dim=-1)


def unit_bits(descriptors: NDArray[np.uint8]) -> Tensor:
    """Descriptors that are bits as (N, 8 D) float32 of unit length.

    Bits are signs, so that the squared distance of two is 4 / (8 D) of their Hamming distance.
    """
    bits = torch.from_numpy(np.unpackbits(descriptors, axis=1))
    return torch.nn.functional.normalize(2 * bits.float() - 1, dim=-1)


@contextmanager
def written_features(path: Path) -> Iterator[Callable[[str, Features], None]]:
    """Write a file of features, whole or not at all, by what it gives: a function that adds those
    of an image.

    Raises:
        InputError: the folder cannot be written.
    """
    with written_whole(path) as partial, h5py.File(partial, "w") as file:

        def add(name: str, item: Features) -> None:
            # Names hold slashes, which HDF5 would take for groups.
            if "\\" in name:
                group = file.create_group(f"\\{len(file)}")
                set_text(group, _NAME, name)
            else:
                group = file.create_group(name.replace("/", "\\"))
            group["xy"], group["scale"] = item.xy, item.scale
            group["descriptors"] = item.descriptors

        yield add


def _name(stored: str, of: h5py.Group) -> str:
    return str(attribute(of, _NAME)) if _NAME in of.attrs else stored.replace("\\", "/")


def write_features(path: Path, features: Mapping[str, Features]) -> None:
    """Write the features of several images by name, atomically.

    Raises:
        InputError: the folder cannot be written.
    """
    with written_features(path) as add:
        for name, item in features.items():
            add(name, item)


class FeatureFile(Mapping[str, Features]):
    """What ``write_features`` wrote, read image by image when asked for, and not kept.

    The file stays open, so that it may be removed meanwhile. Threads may share it.

    Raises:
        InputError: missing or damaged file; also when features are read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            require_readable(path, "feature file")
            self._file = h5py.File(path, "r")
            self._groups = {_name(stored, of): stored for stored, of in groups(self._file)}
        except HDF5_DAMAGE as error:
            raise self._damaged(error) from None

    def __len__(self) -> int:
        return len(self._groups)

    def __iter__(self) -> Iterator[str]:
        return iter(self._groups)

    def __getitem__(self, name: str) -> Features:
        stored = self._groups[name]
        try:
            found = group(self._file, stored)
            return Features(*(array(found, part) for part in ("xy", "scale", "descriptors")))
        except HDF5_DAMAGE as error:
            raise self._damaged(error) from None

    def _damaged(self, error: Exception) -> InputError:
        return InputError(f"feature file {self.path} is missing or damaged: {error}")


def read_features(path: Path) -> dict[str, Features]:
    """Read all that ``write_features`` wrote.

    Raises:
        InputError: missing or damaged file.
    """
    return dict(FeatureFile(path))
