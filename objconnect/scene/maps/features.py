"""Local features of images: keypoints and descriptors, in memory and in an HDF5 file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import HDF5_DAMAGE, InputError
from objconnect.scene.storage.digests import sha256
from objconnect.scene.storage.files import require_readable
from objconnect.scene.storage.hdf5 import array, attribute, group, groups, set_text
from objconnect.scene.storage.hdf5_writing import hdf5_file

if TYPE_CHECKING:
    from torch import Tensor

# A group has the name of its image with "\" for "/". If the image's name contains "\", the group is
# numbered and this attribute holds the name.
_NAME = "name"
# Attribute of the file with the digest of ``features_key``.
_INPUTS_DIGEST = "made_of"


@dataclass(frozen=True)
class Features:
    """Keypoints and descriptors of one image.

    Attributes:
        xy: keypoints, (N, 2) float32 COLMAP pixels.
        scale: sizes of the keypoints, (N,) float32 pixels.
        descriptors: (N, D), as the extractor returns them: vectors of float32 or uint8 (COLMAP's
            RootSIFT is 128 uint8 of length 512), or bits packed in uint8.

    Examples:
        >>> features = Features(
        ...     xy=np.array([[10.5, 20.5]], np.float32),
        ...     scale=np.array([2.0], np.float32),
        ...     descriptors=np.array([[3, 4]], np.uint8),
        ... )
        >>> unit_descriptors(features.descriptors)
        tensor([[0.6000, 0.8000]])
    """

    xy: NDArray[np.float32]
    scale: NDArray[np.float32]
    descriptors: NDArray[Any]


def unit_descriptors(descriptors: NDArray[Any]) -> Tensor:
    """Return vector descriptors (N, D) as float32 of unit length."""
    import torch

    return torch.nn.functional.normalize(torch.from_numpy(descriptors).float(), dim=-1)


def unit_bits(descriptors: NDArray[np.uint8]) -> Tensor:
    """Return binary descriptors (N, D) uint8 as (N, 8 D) float32 of unit length.

    Bits become signs: the squared distance of two descriptors is 4 / (8 D) times their Hamming
    distance.
    """
    import torch

    bits = torch.from_numpy(np.unpackbits(descriptors, axis=1))
    return torch.nn.functional.normalize(2 * bits.float() - 1, dim=-1)


def features_key(photographs: Mapping[str, str], options: str) -> str:
    """Return a digest of the inputs of feature extraction.

    Args:
        photographs: digest of each photograph's bytes by name.
        options: options of the extractor as text.
    """
    # The text must not change, because existing files hold its digest.
    return sha256(f"{list(photographs.items())} {options} None ")


def _image_name(group_name: str, node: h5py.Group) -> str:
    return str(attribute(node, _NAME)) if _NAME in node.attrs else group_name.replace("\\", "/")


def write_features(path: Path, features: Mapping[str, Features], inputs_digest: str = "") -> None:
    """Write the features of several images to an HDF5 file atomically.

    Args:
        path: file to write.
        features: features by image name.
        inputs_digest: digest of ``features_key``; empty if unknown.

    Raises:
        InputError: the folder cannot be written.
    """
    with hdf5_file(path) as file:
        if inputs_digest:
            set_text(file, _INPUTS_DIGEST, inputs_digest)
        for name, item in features.items():
            # HDF5 would make nested groups of a name with slashes.
            if "\\" in name:
                node = file.create_group(f"\\{len(file)}")
                set_text(node, _NAME, name)
            else:
                node = file.create_group(name.replace("/", "\\"))
            node["xy"], node["scale"] = item.xy, item.scale
            node["descriptors"] = item.descriptors


class FeatureFile(Mapping[str, Features]):
    """A mapping from image name to features that reads from the file on each access.

    It caches nothing. The file stays open and may be removed meanwhile. Threads may share the
    mapping.

    Attributes:
        path: path of the file.
        inputs_digest: digest of ``features_key``; empty if the file has none.

    Raises:
        InputError: the file is missing or damaged; access may raise it too.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            require_readable(path, "feature file")
            self._file = h5py.File(path, "r")
            self._groups = {_image_name(key, node): key for key, node in groups(self._file)}
            is_stated = _INPUTS_DIGEST in self._file.attrs
            self.inputs_digest = str(attribute(self._file, _INPUTS_DIGEST)) if is_stated else ""
        except HDF5_DAMAGE as error:
            raise self._damage_error(error) from None

    def __len__(self) -> int:
        return len(self._groups)

    def __iter__(self) -> Iterator[str]:
        return iter(self._groups)

    def __getitem__(self, name: str) -> Features:
        key = self._groups[name]
        try:
            node = group(self._file, key)
            return Features(*(array(node, part) for part in ("xy", "scale", "descriptors")))
        except HDF5_DAMAGE as error:
            raise self._damage_error(error) from None

    def _damage_error(self, error: Exception) -> InputError:
        return InputError(f"feature file {self.path} is missing or damaged: {error}")


def read_features(path: Path) -> dict[str, Features]:
    """Read all features of a file that ``write_features`` wrote, by image name.

    Raises:
        InputError: the file is missing or damaged.
    """
    return dict(FeatureFile(path))
