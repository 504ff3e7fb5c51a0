"""The authors' files of weights, recognized by their digests.

Files of different networks may hold tensors of equal names and shapes, so that each loads into the
other's network.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

from objconnect.scene.errors import InputError


class KnownFile(NamedTuple):
    """A file of weights: its name, its network, and the SHA-256 of its bytes in hex."""

    name: str
    network: str
    sha256: str


KNOWN_FILES: Final = (
    KnownFile(
        "aliked-n16.pth",
        "ALIKED aliked-n16",
        "5be8704840ed662d9d8c561bf7279c222092674e7eb05fd0feab94899e9d82f2",
    ),
    KnownFile(
        "aliked-n16rot.pth",
        "ALIKED aliked-n16rot",
        "ddf3abbf38e86f6a74540d214e1a9712c54b2d8551abc864542199f2347d7332",
    ),
    KnownFile(
        "aliked-n32.pth",
        "ALIKED aliked-n32",
        "055283fd1624d3ab46a05c3b617b1a79a3f28d1f551737eef2d653e8c8232890",
    ),
    KnownFile(
        "disk-depth-save.pth",
        "DISK depth",
        "9c2ee4ded238892dfa51569941372601e35e4a74aa6f84ea80053d2ab1c07abe",
    ),
    KnownFile(
        "aliked_lightglue.pth",
        "LightGlue aliked",
        "d975e965b105311a6143194852297dff4f02aea5cc2e10cecfed966ca0e22503",
    ),
    KnownFile(
        "disk_lightglue.pth",
        "LightGlue disk",
        "b5b21d47ea24f2c5e501aec9c91b9716e4c8c3429a4dc1e615c133c4c9378335",
    ),
)
"""The files that the model card ``lightglue.md`` lists."""


def require_network(path: Path, sha256: str, network: str) -> None:
    """Refuse a known file of another network; files that are not known pass.

    Args:
        path: file of weights.
        sha256: digest of its bytes.
        network: the network that is to be loaded, named as in ``KNOWN_FILES``.

    Raises:
        InputError: the file holds the weights of another network.
    """
    for known in KNOWN_FILES:
        if known.sha256 == sha256 and known.network != network:
            raise InputError(
                f"{path} holds the weights of {known.network}, those of {network} are needed"
            )
