"""Random generators of the sessions of a scene.

Whoever knows the poses of the map's photographs knows numbers that the generator of its session
drew. Seeds of at most 31 bits can be found from them by trying all, and the state of the generator
(PCG64) can be computed from them (Bouillaguet et al., Practical seed-recovery for the PCG
pseudo-random number generator, ToSC 2020). The longer seeds of sealed places therefore reach a
generator through SHA-256, so that one session tells nothing about another.
"""

from __future__ import annotations

import hashlib
from typing import Final

import numpy as np

from objconnect.scene.config import MAX_NUMBER

MAX_SEED: Final = 2**128 - 1
"""Largest seed of a scene. Seeds above ``MAX_NUMBER`` are for sealed places."""

# Third number of the seeds of changes. Seeds of courses have no third number or a byte (below 256).
_CHANGE: Final = 1 << 16


def course_generator(seed: int, index: int, preset: str) -> np.random.Generator:
    """Return the generator of a session's course, its wind and the noise of its priors.

    Args:
        seed: seed of the scene.
        index: number of the session in the configuration.
        preset: preset of the place; empty if all presets of one seed have the same flights.
    """
    return _generator(seed, index, *preset.encode())


def change_generator(seed: int, index: int, preset: str) -> np.random.Generator:
    """Return the generator that decides whether the change of a session happens."""
    return _generator(seed, index, _CHANGE, *preset.encode())


def _generator(*numbers: int) -> np.random.Generator:
    if numbers[0] <= MAX_NUMBER:
        return np.random.default_rng(numbers)
    digest = hashlib.sha256(" ".join(map(str, numbers)).encode()).digest()
    return np.random.default_rng(int.from_bytes(digest, "little"))
