"""Random seeds of rendered sites with withheld query poses (*sealed places*).

The seeds follow from a key that only the organiser of the benchmark has.

The code, the configuration and the map of a sealed place are public. Anyone who knew its seed could
plan the same flights, and so compute the poses of the queries.
"""

from __future__ import annotations

import hmac
from pathlib import Path
from typing import Final

from benchmark.tracks.description import Track, TrackPlace
from objconnect.scene.errors import InputError
from objconnect.scene.storage.files import require_readable

# Smallest and largest number of bytes of a key. They exclude keys of fewer than 128 bits, and most
# photographs and archives that are given by mistake.
_LEAST_BYTES: Final = 16
_MOST_BYTES: Final = 4096
# Smallest number of different bytes. Fewer than one in 10,000 keys of 16 random bytes or
# hexadecimal digits have fewer.
_LEAST_DIFFERENT: Final = 6


def read_key(path: Path) -> bytes:
    """Read the key of sealed places, which is the whole file.

    Raises:
        InputError: the file cannot be read, is too short or too long, or is not random.
    """
    require_readable(path, "key")
    try:
        size = path.stat().st_size
        if not _LEAST_BYTES <= size <= _MOST_BYTES:
            raise InputError(
                f"key {path} has {size} bytes, not {_LEAST_BYTES} to {_MOST_BYTES}: make one with "
                "'head -c 32 /dev/urandom > FILE'"
            )
        key = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read key {path}: {error.strerror}") from None
    if len(set(key)) < _LEAST_DIFFERENT:
        raise InputError(
            f"key {path} is not random: make one with 'head -c 32 /dev/urandom > FILE'"
        )
    return key


def sealed_seed(key: bytes, track: Track, place: TrackPlace) -> int:
    """Return the seed of a sealed place: the first 128 bits of HMAC-SHA256 of its name.

    A seed of 31 bits, like the seeds of other places, could be found by trying all of them.
    """
    digest = hmac.digest(key, f"{track.name}/{place.dataset}".encode(), "sha256")
    return int.from_bytes(digest[:16], "big")
