"""Work on the cores of a Ray cluster: the one module that speaks to Ray.

Written for Ray 2.48, the extra ``[cluster]``, which is loaded only where a cluster is asked for.
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
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from itertools import islice
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

from scene.errors import InputError

# How often a unit is done again whose worker was lost, or which failed for no fault of the input.
_RETRIES: Final = 5
# For an answer from the head of a cluster.
_PATIENCE_S: Final = 10
# Units handed out for each core; the rest wait here, so that few results wait in Ray's memory.
_AHEAD: Final = 2
# What results wait in, where we start Ray ourselves.
_STORE_BYTES: Final = 200 << 20
_ADDRESS: Final = re.compile(r"local|auto|[^/:\s]+:\d+")
# Results are the same bit for bit only where these are.
_COMPUTING: Final = ("objconnect", "numpy", "torch", "pycolmap", "bpy")

Item = TypeVar("Item")
Unit = TypeVar("Unit")
Result = TypeVar("Result")

Work = Callable[[Unit], Iterable[Result]]
"""What workers do: a unit's results, the same ones in the same order whenever it is called."""


@dataclass(frozen=True)
class _Fault:
    """An InputError on its way to the driver, as a result: Ray would try the unit again."""

    kind: type[InputError]
    message: str


class WorkerPool(Generic[Unit, Result]):
    """Whoever does the same work on many units; this process alone, where there is no cluster."""

    def __init__(self, work: Work[Unit, Result]) -> None:
        self._work = work

    @property
    def cores(self) -> int:
        """How many units are worked on at a time."""
        return 1

    def map(self, units: Iterable[Unit]) -> Generator[Result, None, None]:
        """Do units of work; yield each result as soon as it is there, of whatever unit.

        Raises:
            InputError: a unit raised it, or was lost with its worker again and again.
        """
        for unit in units:
            yield from self._work(unit)


class _RayPool(WorkerPool[Unit, Result]):
    """Worker processes, one a core. A unit whose worker is lost is done again by another; what it
    had yielded before is not yielded twice."""

    def __init__(self, ray: Any, work: Work[Unit, Result]) -> None:
        super().__init__(work)
        self._ray = ray
        self._put = ray.put(work)
        self._do = ray.remote(
            num_cpus=1, max_retries=_RETRIES, retry_exceptions=True, num_returns="streaming"
        )(_do)

    @property
    def cores(self) -> int:
        return int(self._ray.cluster_resources().get("CPU", 0))

    def map(self, units: Iterable[Unit]) -> Generator[Result, None, None]:
        ray = self._ray
        left, running = iter(units), set[Any]()
        home, versions = str(Path.cwd()), _versions()
        try:
            while True:
                # As many as there are cores for now: nodes come and go.
                room = _AHEAD * max(1, self.cores) - len(running)
                for unit in islice(left, max(0, room)):
                    running.add(self._do.remote([self._put], unit, home, versions))
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
                f"a unit of work was lost {_RETRIES + 1} times: {reason}; run again to go on"
            ) from None
        finally:
            for unfinished in running:
                ray.cancel(unfinished, force=True)


def require_address(address: str | None) -> None:
    """InputError: it is none of those that ``worker_pool`` takes."""
    if address is not None and not _ADDRESS.fullmatch(address):
        raise InputError(f"--cluster takes local, auto or HOST:PORT, got {address!r}")


@contextmanager
def worker_pool(
    address: str | None, work: Work[Unit, Result]
) -> Iterator[WorkerPool[Unit, Result]]:
    """Connect to a cluster, whose workers' messages appear on this process's standard error.

    Args:
        address: "local" starts Ray on this machine alone, and ends it afterwards; "auto" is the
            cluster that this machine is a node of; or "host:port" of its head. None is no cluster.
        work: picklable. Every worker process has a copy of its own and keeps it, so that it may
            hold what is costly to make. Relative paths start at this process's folder, where the
            worker's machine has it.

    Raises:
        InputError: no Ray, no such cluster, or one without a core.
    """
    if address is None:
        yield WorkerPool(work)
        return
    require_address(address)
    ray = _ray()
    if ":" in address:
        _require_answer(address)
    own = {"include_dashboard": False, "object_store_memory": _STORE_BYTES}
    try:
        with _kept_handler():
            ray.init(
                address=address,
                logging_level=logging.ERROR,
                log_to_driver=True,
                **(own if address == "local" else {}),
            )
    except Exception as error:  # Ray says it with whatever is at hand
        reason = " ".join(str(error).split("\n")[0].split())
        raise InputError(
            f"cannot work on the Ray cluster {address!r}: {reason or type(error).__name__}; run "
            "this on a node of it, as docs/cluster.md says"
        ) from None
    try:
        workers = _RayPool(ray, work)
        if not workers.cores:
            raise InputError(f"the Ray cluster {address!r} has no core to work with")
        yield workers
    finally:
        ray.shutdown()


def _ray() -> Any:
    """Ray, told to ask nobody's server, and to wait for workers that start on a busy machine."""
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
def _kept_handler() -> Iterator[None]:
    """What this process does when it is told to end stays as it is: Ray puts an exit of its own in
    the place of our cleaning up."""
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        # No other thread may; None is of no Python's making.
        if before is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, before)


def _require_answer(address: str) -> None:
    """InputError when nobody listens there, which takes Ray two minutes to find out."""
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=_PATIENCE_S).close()
    except (OSError, OverflowError) as error:
        raise InputError(f"no Ray cluster answers at {address}: {error}") from None


def shares(items: Sequence[Item], cores: int, least: int, most: int) -> list[Sequence[Item]]:
    """Divide items into units, large ones first: nobody waits long for the last one to be done.

    Every round is of as many equal units as there are cores, of half of what is left between them;
    the last round takes all (Hummel et al., "Factoring", CACM 1992).

    Args:
        items: in order.
        cores: to share among.
        least: items that are worth a unit, where there are enough for every core.
        most: items of a unit.
    """
    units: list[Sequence[Item]] = []
    start = 0
    while start < len(items):
        each = math.ceil((len(items) - start) / cores)
        size = min(most, each if each <= 2 * least else math.ceil(each / 2))
        end = min(len(items), start + cores * size)
        units += [items[first : min(end, first + size)] for first in range(start, end, size)]
        start = end
    return units


# The copy of the work that this worker process keeps, by its reference.
_kept: dict[str, Work[Any, Any]] = {}


def _do(
    boxed: list[Any], unit: Any, home: str, versions: dict[str, str]
) -> Generator[Any, None, None]:
    """Runs on the workers. The box keeps Ray from unpacking the work for every unit."""
    try:
        if _versions() != versions:
            raise InputError(_differing(versions))
        name = boxed[0].hex()
        if name not in _kept:
            with suppress(OSError):
                os.chdir(home)
            _kept[name] = _ray().get(boxed[0])
        yield from _kept[name](unit)
    except InputError as error:
        yield _Fault(type(error), str(error))


def _versions() -> dict[str, str]:
    found = {}
    for package in _COMPUTING:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


def _differing(wanted: dict[str, str]) -> str:
    here = _versions()
    package = next(p for p in _COMPUTING if here.get(p) != wanted.get(p))
    return (
        f"node {os.uname().nodename} has {package} {here.get(package, 'not')} and this machine "
        f"{wanted.get(package, 'not')}: install the same on every node"
    )
