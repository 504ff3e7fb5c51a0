"""What is read when needed: the values used last stay in memory, up to so many bytes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Final, Generic, Protocol, TypeVar

from scene.runtime.memory import resident_bytes

MEGABYTE: Final = 2**20


class _Sized(Protocol):
    @property
    def nbytes(self) -> int: ...


K = TypeVar("K", bound=Hashable)
V = TypeVar("V", bound=_Sized)


def room(bound_mb: int) -> int:
    """Bytes that values may take so that the whole process, as it is now, stays below a bound.

    Half of what is left below it: the other half is for what a query needs while it is asked.
    """
    return max(0, (bound_mb * MEGABYTE - resident_bytes()) // 2)


class LruCache(Generic[K, V]):
    """Values by key. Threads may share it.

    Args:
        read: finds the value of a key that is not in memory.
        memory: bytes that values in memory may take, but for a single one that is larger.
    """

    def __init__(self, read: Callable[[K], V], memory: int) -> None:
        self._read = read
        self._memory = memory
        self._values: OrderedDict[K, V] = OrderedDict()
        self._lock = Lock()
        self.nbytes = 0

    def __call__(self, key: K) -> V:
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key]
            found = self._values[key] = self._read(key)
            self.nbytes += found.nbytes
            while self.nbytes > self._memory and len(self._values) > 1:
                _, oldest = self._values.popitem(last=False)
                self.nbytes -= oldest.nbytes
            return found

    def __len__(self) -> int:
        return len(self._values)
