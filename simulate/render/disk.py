"""Check that the disk has room for the frames to render."""

from __future__ import annotations

import shutil
from pathlib import Path

from objconnect.scene.bundle.frames import LAYERS
from objconnect.scene.errors import InputError

# Bytes per pixel of a rendered frame before it is packed: rgb and all layers, uncompressed.
_RAW_BYTES = 3 + sum(
    dtype.itemsize * (3 if layer == "normal" else 1) for layer, dtype in LAYERS.items()
)
# Upper bound of the bytes per pixel of a packed frame. Packing leaves a fifth to a quarter of the
# raw bytes at 512 px, and more for smaller frames.
_PACKED_BYTES = 0.5 * _RAW_BYTES
_RAW_THERMAL_BYTES, _PACKED_THERMAL_BYTES = 4, 3


def estimate_bytes(left: dict[str, tuple[int, int]], pixels: int, *, thermal: bool = False) -> int:
    """Return an upper bound of the disk space that sessions still need, bytes.

    Args:
        left: numbers of frames to render and to pack, by session.
        pixels: number of pixels of a frame.
        thermal: whether frames have thermal pictures.
    """
    packed = sum(to_pack for _, to_pack in left.values())
    # Only one session at a time has unpacked frames.
    unpacked = max((to_render for to_render, _ in left.values()), default=0)
    per_packed = _PACKED_BYTES + _PACKED_THERMAL_BYTES * thermal
    per_unpacked = _RAW_BYTES + _RAW_THERMAL_BYTES * thermal
    return int(pixels * (per_packed * packed + per_unpacked * unpacked))


def require_space(folder: Path, needed: int) -> None:
    """Check the free space on the disk of a folder, which need not exist yet.

    Raises:
        InputError: less than ``needed`` bytes are free.
    """
    existing = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
    free = shutil.disk_usage(existing).free
    if free < needed:
        raise InputError(
            f"the scene needs up to {_readable(needed)} more and the disk of {folder} has "
            f"{_readable(free)} free: free disk space, choose another folder, or render fewer or "
            "smaller frames"
        )


def _readable(count: int) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"
