"""A Ray cluster of two nodes on this machine, one of which can be killed at work."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

from objconnect.scene.runtime import cluster
from objconnect.scene.runtime.cluster import Work, _import_ray, _keep_handler, _RayPool

# A busy machine takes longer to start a node than Ray waits.
_ATTEMPTS = 4
_STORE_BYTES = 100 << 20
# Seconds after which something hangs, also on a busy machine.
_HANGS_S = 600.0


class _Held:
    """Work that goes on after its first result only once a file exists.

    Args:
        work: the work.
        go_on: the file.
    """

    def __init__(self, work: Work[Any, Any], go_on: Path) -> None:
        self._work, self._go_on = work, go_on

    def __call__(self, unit: Any) -> Iterator[Any]:
        for result in self._work(unit):
            yield result
            end = time.monotonic() + _HANGS_S
            while not self._go_on.exists() and time.monotonic() < end:
                time.sleep(0.02)


class TwoNodes:
    """Two nodes of one core each, beside a head that does no work.

    Attributes:
        address: of the head.
    """

    def __init__(self) -> None:
        self._ray = _import_ray()
        from ray.cluster_utils import Cluster

        head = {"num_cpus": 0, "object_store_memory": _STORE_BYTES, "include_dashboard": False}
        self._cluster = _retry(lambda: Cluster(initialize_head=True, head_node_args=head))
        self.address = str(self._cluster.address)

    def set_node_count(self, count: int) -> None:
        """Start or stop nodes until there are ``count``; only between runs."""
        options = {"num_cpus": 1, "object_store_memory": _STORE_BYTES}
        while len(self._cluster.worker_nodes) > count:
            self._cluster.remove_node(next(iter(self._cluster.worker_nodes)))
        while len(self._cluster.worker_nodes) < count:
            _retry(lambda: self._cluster.add_node(wait=False, **options))
        # The head learns only after seconds of a node that was killed. Until then it may send a
        # driver on this machine there, whose process Ray then ends without a word.
        self._cluster.wait_for_nodes(_HANGS_S)

    @contextmanager
    def killed_at_work(self, when: Callable[[], bool] = lambda: True) -> Iterator[None]:
        """Kill a node inside, once it is at work and `when` says so.

        Units wait after their first result until a node is killed.

        Raises:
            AssertionError: none was.
        """
        self.set_node_count(2)
        over, killed = threading.Event(), threading.Event()

        def watch(go_on: Path) -> None:
            while not over.is_set():
                node = self._at_work() if _is_true(when) else None
                if node is not None:
                    self._cluster.remove_node(node, allow_graceful=False)
                    killed.set()
                    go_on.touch()
                    return
                time.sleep(0.02)

        with TemporaryDirectory(prefix="two-nodes-") as folder:
            go_on = Path(folder) / "go-on"
            watcher = threading.Thread(target=watch, args=[go_on])
            watcher.start()
            try:
                with patch.object(
                    cluster, "_RayPool", lambda ray, work: _RayPool(ray, _Held(work, go_on))
                ):
                    yield
            finally:
                over.set()
                watcher.join()
        assert killed.is_set(), "no node was at work"

    def end(self) -> None:
        self._cluster.shutdown()

    def _at_work(self) -> Any:
        """A node whose worker is at a unit, and which this process does not hang on."""
        own = self._ray._private.worker.global_worker.node
        if own is None:
            return None
        for node in self._cluster.worker_nodes:
            (raylet,) = node.all_processes["raylet"]
            if node.unique_id != own.unique_id and _has_unit(raylet.process.pid):
                return node
        return None


def _is_true(when: Callable[[], bool]) -> bool:
    """What is asked may vanish meanwhile, such as a folder."""
    try:
        return when()
    except OSError:
        return False


def _has_unit(raylet: int) -> bool:
    """Whether a worker of a node is at a unit: Ray gives its process the name of the function."""
    for process in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((process / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == raylet and (process / "cmdline").read_bytes().startswith(
                b"ray::_run_unit"
            ):
                return True
        except (OSError, ProcessLookupError):
            continue
    return False


def _retry(start: Callable[[], Any]) -> Any:
    for attempt in range(_ATTEMPTS):
        try:
            with _keep_handler():
                return start()
        except Exception:
            if attempt == _ATTEMPTS - 1:
                raise
    raise AssertionError
