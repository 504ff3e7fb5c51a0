"""A worker pool: this process, or the cores of a Ray cluster.

Only this module imports Ray (2.48, the extra ``[cluster]``), and only if a cluster is requested.
"""

from __future__ import annotations

import logging
import math
import os
import re
import signal
import socket
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from itertools import islice
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

from objconnect.scene.errors import InputError
from objconnect.scene.runtime.tuning import ProcessTuning, is_tuned

# Number of retries of a unit of work whose worker is lost or that fails other than by InputError.
_RETRIES: Final = 5
# Timeout of the connection to the head of a cluster (s).
_CONNECT_TIMEOUT_S: Final = 10
# Units submitted per core; the others wait in this process, so that results do not fill Ray's
# memory.
_UNITS_PER_CORE: Final = 2
# Size of the object store of a Ray that this process starts.
_STORE_BYTES: Final = 200 << 20
_ADDRESS: Final = re.compile(r"local|auto|[^/:\s]+:\d+")
# Packages that need equal versions on all nodes for bit-equal results.
_NUMERIC_PACKAGES: Final = ("objconnect", "numpy", "torch", "pycolmap", "bpy")

Item = TypeVar("Item")
Unit = TypeVar("Unit")
Result = TypeVar("Result")

Work = Callable[[Unit], Iterable[Result]]
"""A deterministic function from a unit to its results in order."""


@dataclass(frozen=True)
class _Fault:
    """An InputError that a worker returns as a result, because Ray repeats a unit that raises."""

    kind: type[InputError]
    message: str


class WorkerPool(Generic[Unit, Result]):
    """Workers that apply a function to many units; without a cluster, this process.

    Examples:
        >>> with worker_pool(None, lambda unit: [unit * unit]) as workers:
        ...     list(workers.map([1, 2, 3]))
        [1, 4, 9]
    """

    def __init__(self, work: Work[Unit, Result]) -> None:
        self._work = work

    @property
    def cores(self) -> int:
        """Return the number of units that are processed at a time."""
        return 1

    def map(self, units: Iterable[Unit]) -> Generator[Result, None, None]:
        """Apply the function to units; yield results when they are ready, in any order of units.

        Raises:
            InputError: a unit raised it, or was lost with its worker too often.
        """
        for unit in units:
            yield from self._work(unit)


class _RayPool(WorkerPool[Unit, Result]):
    """Worker processes of a Ray cluster, one per core.

    A unit whose worker is lost is repeated; its results are not yielded twice.
    """

    def __init__(self, ray: Any, work: Work[Unit, Result]) -> None:
        super().__init__(work)
        self._ray = ray
        self._work_reference = ray.put(work)
        self._run_unit = ray.remote(
            num_cpus=1, max_retries=_RETRIES, retry_exceptions=True, num_returns="streaming"
        )(_run_unit)

    @property
    def cores(self) -> int:
        return int(self._ray.cluster_resources().get("CPU", 0))

    def map(self, units: Iterable[Unit]) -> Generator[Result, None, None]:
        ray = self._ray
        remaining, running = iter(units), set[Any]()
        directory, versions = str(Path.cwd()), _versions()
        try:
            while True:
                # The number of cores changes as nodes join and leave.
                vacant = _UNITS_PER_CORE * max(1, self.cores) - len(running)
                for unit in islice(remaining, max(0, vacant)):
                    arguments = ([self._work_reference], unit, directory, versions, is_tuned())
                    running.add(self._run_unit.remote(*arguments))
                if not running:
                    return
                ready, _ = ray.wait(list(running), num_returns=1, fetch_local=False)
                try:
                    result = ray.get(next(ready[0]))
                except StopIteration:
                    running.discard(ready[0])
                    continue
                if isinstance(result, _Fault):
                    raise result.kind(result.message)
                yield result
        except ray.exceptions.RayTaskError as error:
            raise error.cause from None
        except ray.exceptions.RayError as error:
            reason = str(error).strip().splitlines()[0]
            raise InputError(
                f"a unit of work was lost {_RETRIES + 1} times: {reason}; run again to continue"
            ) from None
        finally:
            for unfinished in running:
                ray.cancel(unfinished, force=True)


def require_address(address: str | None) -> None:
    """Refuse an address that ``worker_pool`` does not take.

    Raises:
        InputError: the address has the wrong form.
    """
    if address is not None and not _ADDRESS.fullmatch(address):
        raise InputError(f"--cluster takes local, auto or HOST:PORT, got {address!r}")


@contextmanager
def worker_pool(
    address: str | None, work: Work[Unit, Result]
) -> Iterator[WorkerPool[Unit, Result]]:
    """Connect to a cluster; messages of its workers appear on this process's standard error.

    Args:
        address: "local" starts Ray on this machine and stops it afterwards; "auto" is the cluster
            of which this machine is a node; "host:port" is the head of a cluster. None uses this
            process alone.
        work: picklable function. Every worker process keeps its own copy, which may cache
            state. Relative paths refer to this process's working directory, if the worker's machine
            has it.

    Raises:
        InputError: Ray is not installed, the cluster does not exist, or it has no core.
    """
    if address is None:
        yield WorkerPool(work)
        return
    require_address(address)
    ray = _import_ray()
    if ":" in address:
        _require_answer(address)
    local_options = {"include_dashboard": False, "object_store_memory": _STORE_BYTES}
    try:
        with _keep_handler():
            ray.init(
                address=address,
                logging_level=logging.ERROR,
                log_to_driver=True,
                **(local_options if address == "local" else {}),
            )
    except Exception as error:  # Ray raises many different exceptions here
        reason = " ".join(str(error).split("\n")[0].split())
        raise InputError(
            f"cannot work on the Ray cluster {address!r}: {reason or type(error).__name__}; run "
            "this on one of its nodes, as docs/cluster.md says"
        ) from None
    try:
        workers = _RayPool(ray, work)
        if not workers.cores:
            raise InputError(f"the Ray cluster {address!r} has no core to work with")
        yield workers
    finally:
        ray.shutdown()


def _import_ray() -> Any:
    """Import Ray without usage statistics and with a long timeout for busy machines."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_worker_register_timeout_seconds", "600")
    try:
        import ray
    except ImportError:
        raise InputError(
            "--cluster needs Ray, which is not installed: pip install 'objconnect[cluster]'"
        ) from None
    return ray


@contextmanager
def _keep_handler() -> Iterator[None]:
    """Restore the handler of SIGTERM after the block: Ray installs one that skips our clean-up."""
    handler = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        # Only the main thread may set a handler; None means it was not installed from Python.
        if handler is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, handler)


def _require_answer(address: str) -> None:
    """Raise InputError if nothing listens at the address; Ray takes two minutes to notice."""
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=_CONNECT_TIMEOUT_S).close()
    except (OSError, OverflowError) as error:
        raise InputError(f"no Ray cluster answers at {address}: {error}") from None


def split_work(
    items: Sequence[Item], cores: int, min_size: int, max_size: int
) -> list[Sequence[Item]]:
    """Divide items into units, large ones first, so that all workers finish at about the same time.

    Each round has one unit of equal size per core, together half of the remaining items; the last
    round takes all of them (Hummel et al., "Factoring", CACM 1992).

    Args:
        items: items in order.
        cores: number of workers.
        min_size: smallest number of items per unit, if there are enough for every core.
        max_size: largest number of items per unit.

    Examples:
        >>> [len(unit) for unit in split_work(range(20), cores=2, min_size=2, max_size=100)]
        [5, 5, 3, 3, 2, 2]
    """
    units: list[Sequence[Item]] = []
    start = 0
    while start < len(items):
        each = math.ceil((len(items) - start) / cores)
        size = min(max_size, each if each <= 2 * min_size else math.ceil(each / 2))
        end = min(len(items), start + cores * size)
        units += [items[first : min(end, first + size)] for first in range(start, end, size)]
        start = end
    return units


# The function of this worker process by its reference in the object store.
_work_by_reference: dict[str, Work[Any, Any]] = {}
# Contexts that this worker process stays in until it ends.
_worker_contexts = ExitStack()


def _run_unit(
    reference: list[Any], unit: Any, directory: str, versions: dict[str, str], tuned: bool
) -> Generator[Any, None, None]:
    """Run one unit on a worker; the reference is in a list, because Ray unpacks a bare one."""
    try:
        if _versions() != versions:
            raise InputError(_describe_difference(versions))
        name = reference[0].hex()
        if name not in _work_by_reference:
            with suppress(OSError):
                os.chdir(directory)
            if tuned and not is_tuned():
                _worker_contexts.enter_context(ProcessTuning())
            _work_by_reference[name] = _import_ray().get(reference[0])
        yield from _work_by_reference[name](unit)
    except InputError as error:
        yield _Fault(type(error), str(error))


def _versions() -> dict[str, str]:
    versions = {}
    for package in _NUMERIC_PACKAGES:
        with suppress(PackageNotFoundError):
            versions[package] = version(package)
    return versions


def _describe_difference(wanted: dict[str, str]) -> str:
    local = _versions()
    package = next(p for p in _NUMERIC_PACKAGES if local.get(p) != wanted.get(p))
    return (
        f"node {os.uname().nodename} has {package} {local.get(package, '(none)')} and this "
        f"machine {wanted.get(package, '(none)')}: install the same version on every node"
    )
