"""Random generators of the sessions (flights) of a scene.

The published poses of a map reveal random numbers that were drawn for the map's session. From such
numbers, a seed of at most 31 bits can be found by trying all seeds, and the state of the generator
(PCG64) can be computed (Bouillaguet et al., Practical seed-recovery for the PCG pseudo-random
number generator, ToSC 2020). Sealed places, whose query poses are not published, therefore have
longer seeds, and each session's generator is seeded with a SHA-256 digest of the seed, so that one
session reveals nothing about another.
"""

from __future__ import annotations

import hashlib
from typing import Final

import numpy as np

from objconnect.scene.config import MAX_NUMBER

MAX_SEED: Final = 2**128 - 1
"""Largest seed of a scene. Seeds above ``MAX_NUMBER`` are for sealed places."""

# Third number of the seeds of changed objects. In the seeds of flight paths the third number is
# absent, or is a byte of the preset's name (below 256).
_CHANGE: Final = 1 << 16


def course_generator(seed: int, index: int, preset: str) -> np.random.Generator:
    """Return the generator of a session's path, its wind and the noise of its priors.

    Args:
        seed: seed of the scene.
        index: index of the session in the configuration, from 0.
        preset: preset of the place; empty if all presets of one seed have the same flights.
    """
    return _generator(seed, index, *preset.encode())


def change_generator(seed: int, index: int, preset: str) -> np.random.Generator:
    """Return the generator that decides whether the objects of a session are changed.

    The objects are changed (``SessionConfig.change``) with probability ``change_share``.
    """
    return _generator(seed, index, _CHANGE, *preset.encode())


def _generator(*numbers: int) -> np.random.Generator:
    if numbers[0] <= MAX_NUMBER:
        return np.random.default_rng(numbers)
    digest = hashlib.sha256(" ".join(map(str, numbers)).encode()).digest()
    return np.random.default_rng(int.from_bytes(digest, "little"))
