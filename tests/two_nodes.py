"""A Ray cluster of two nodes on this machine, of which one can be killed at its work."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from scene.cluster import _ray

# A busy machine takes longer to start a node than Ray waits.
_ATTEMPTS = 4
_STORE_BYTES = 100 << 20


class TwoNodes:
    """One node of one core that stays, and one at a time that does not."""

    def __init__(self) -> None:
        _ray()  # before anything of Ray is loaded, so that it asks nobody's server
        from ray.cluster_utils import Cluster

        self._cluster = _patiently(
            lambda: Cluster(
                initialize_head=True,
                head_node_args={
                    "num_cpus": 1,
                    "object_store_memory": _STORE_BYTES,
                    "include_dashboard": False,
                },
            )
        )
        self._second: Any = None

    @property
    def address(self) -> str:
        return str(self._cluster.address)

    @contextmanager
    def killed_at_work(self, when: Callable[[], bool] = lambda: True) -> Iterator[None]:
        """Kill the second node inside, once it is at work and `when` says so.

        Raises:
            AssertionError: it never was.
        """
        self.whole()
        over, killed = threading.Event(), threading.Event()

        def watch() -> None:
            while not over.is_set():
                if when() and _works(self._raylet()):
                    self._cluster.remove_node(self._second, allow_graceful=False)
                    killed.set()
                    return
                time.sleep(0.02)

        watcher = threading.Thread(target=watch)
        watcher.start()
        try:
            yield
        finally:
            over.set()
            watcher.join()
            if killed.is_set():
                self._second = None
        assert killed.is_set(), "the second node was never at work"

    def whole(self) -> None:
        """See that there are two nodes."""
        if self._second is None:
            self._second = _patiently(
                lambda: self._cluster.add_node(num_cpus=1, object_store_memory=_STORE_BYTES)
            )

    def one(self) -> None:
        """See that there is one node."""
        if self._second is not None:
            self._cluster.remove_node(self._second)
            self._second = None

    def end(self) -> None:
        self._cluster.shutdown()

    def _raylet(self) -> int:
        (raylet,) = self._second.all_processes["raylet"]
        return int(raylet.process.pid)


def _works(raylet: int) -> bool:
    """Whether a worker of a node is at a unit: Ray gives its process the name of the function."""
    for process in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((process / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == raylet and (process / "cmdline").read_bytes().startswith(b"ray::_do"):
                return True
        except (OSError, ProcessLookupError):
            continue
    return False


def _patiently(start: Callable[[], Any]) -> Any:
    for attempt in range(_ATTEMPTS):
        try:
            return start()
        except Exception:
            if attempt == _ATTEMPTS - 1:
                raise
    raise AssertionError
