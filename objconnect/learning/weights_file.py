"""The file of weights that an option names: a file, or a published folder with one."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from objconnect.scene.errors import InputError
from objconnect.scene.storage.checksums import CHECKSUMS, read_checksums
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.hub import download, is_address

SUFFIX: Final = ".safetensors"
# Calibration files lie beside the weights; see ``localization.featuremetric.calibration_files``.
_CHECKED_SUFFIXES: Final = (SUFFIX, ".yaml")


def find_weights(path: Path) -> Path:
    """Return the file of weights that a path names.

    Args:
        path: a file, whose path is returned; a folder that ``publish-weights`` wrote; or the
            address of such a folder, ``hf://OWNER/NAME@COMMIT``.

    Raises:
        InputError: the address cannot be read, ``publish-weights`` did not write the folder, or a
            file in it is missing or was changed.
    """
    if is_address(path):
        path = download(path, "model", [CHECKSUMS, *(f"*{suffix}" for suffix in _CHECKED_SUFFIXES)])
    if not path.is_dir():
        return path
    if not (path / CHECKSUMS).is_file():
        raise InputError(
            f"{path} is a folder without {CHECKSUMS}: give a file of weights, or a folder that "
            "publish-weights wrote"
        )
    checked_digests = {
        name: digest
        for name, digest in read_checksums(path).items()
        if "/" not in name and name.endswith(_CHECKED_SUFFIXES)
    }
    weights = [name for name in checked_digests if name.endswith(SUFFIX)]
    if len(weights) != 1:
        raise InputError(f"{path / CHECKSUMS} lists {len(weights)} files of weights: give one file")
    for name, digest in checked_digests.items():
        if not (path / name).is_file():
            raise InputError(f"{path / name} does not exist: download the weights again")
        if sha256_of(path / name) != digest:
            raise InputError(f"{path / name} is not the file that was published: download it again")
    return path / weights[0]
