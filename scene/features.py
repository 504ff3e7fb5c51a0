"""Local features of images, in memory and on disk."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scene.errors import HDF5_DAMAGE, InputError
from scene.files import written_whole
from scene.hdf5 import array, groups


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


def unit_descriptors(features: Features) -> Tensor:
    """Descriptors that are vectors as (N, D) float32 of unit length, ready to match."""
    return torch.nn.functional.normalize(torch.from_numpy(features.descriptors).float(), dim=-1)


def unit_bits(features: Features) -> Tensor:
    """Descriptors that are bits as (N, 8 D) float32 of unit length.

    Bits are signs, so that the squared distance of two is 4 / (8 D) of their Hamming distance.
    """
    bits = torch.from_numpy(np.unpackbits(features.descriptors, axis=1))
    return torch.nn.functional.normalize(2 * bits.float() - 1, dim=-1)


def write_features(path: Path, features: Mapping[str, Features]) -> None:
    """Write the features of several images by name, atomically.

    Raises:
        InputError: the folder cannot be written.
    """
    with written_whole(path) as partial, h5py.File(partial, "w") as file:
        for name, item in features.items():
            # Names hold slashes, which HDF5 would take for groups.
            group = file.create_group(name.replace("/", "\\"))
            group["xy"], group["scale"] = item.xy, item.scale
            group["descriptors"] = item.descriptors


def read_features(path: Path) -> dict[str, Features]:
    """Read what ``write_features`` wrote.

    Raises:
        InputError: missing or damaged file.
    """
    try:
        with h5py.File(path, "r") as file:
            return {
                name.replace("\\", "/"): Features(
                    *(array(group, part) for part in ("xy", "scale", "descriptors"))
                )
                for name, group in groups(file)
            }
    except HDF5_DAMAGE as error:
        raise InputError(f"feature file {path} is missing or damaged: {error}") from None
