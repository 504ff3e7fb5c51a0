"""A cache bounded in bytes that drops the least recently used values."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Final, Generic, Protocol, TypeVar

from objconnect.scene.runtime.memory import resident_bytes
from objconnect.scene.runtime.tuning import trim_heap

MEGABYTE: Final = 2**20
"""Bytes of a megabyte in memory bounds."""


class _Sized(Protocol):
    @property
    def nbytes(self) -> int: ...


K = TypeVar("K", bound=Hashable)
V = TypeVar("V", bound=_Sized)


def free_cache_bytes(bound_mb: int) -> int:
    """Return the bytes that a cache may use so that the process stays below a memory bound.

    It is half of the memory that is left below the bound after trimming the heap. The other half is
    for a second cache and for queries.

    Args:
        bound_mb: memory bound of the process, megabytes.
    """
    trim_heap()
    return max(0, (bound_mb * MEGABYTE - resident_bytes()) // 2)


class LruCache(Generic[K, V]):
    """A cache bounded in bytes that drops the least recently used values; threads may share it.

    Args:
        read: returns the value of a key that is not in the cache.
        memory: bytes that the values may use; a single larger value is kept.

    Attributes:
        nbytes: bytes that the values use.

    Examples:
        >>> import numpy as np
        >>> cache = LruCache(lambda size: np.zeros(size, np.uint8), memory=100)
        >>> cache(60).size, cache(50).size
        (60, 50)
        >>> len(cache), cache.nbytes
        (1, 50)
    """

    def __init__(self, read: Callable[[K], V], memory: int) -> None:
        self._read = read
        self._memory = memory
        self._values: OrderedDict[K, V] = OrderedDict()
        self._lock = Lock()
        self.nbytes = 0

    def __call__(self, key: K) -> V:
        """Return the value of a key, read unless it is in the cache."""
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key]
            value = self._values[key] = self._read(key)
            self.nbytes += value.nbytes
            while self.nbytes > self._memory and len(self._values) > 1:
                _, oldest = self._values.popitem(last=False)
                self.nbytes -= oldest.nbytes
            return value

    def __len__(self) -> int:
        return len(self._values)
