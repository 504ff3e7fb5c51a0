"""Work on a cluster: units lost with a node are repeated, and mistakes give one line."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.runtime.cluster import split_work, worker_pool
from tests.two_nodes import TwoNodes

pytestmark = pytest.mark.thorough


def count_to_five(unit: int) -> Iterator[tuple[int, int]]:
    for k in range(5):
        yield unit, k


class Counting:
    """Work that counts the units which its copy in a process has done."""

    def __init__(self) -> None:
        self._done = 0

    def __call__(self, unit: int) -> Iterator[tuple[int, int]]:
        self._done += 1
        yield os.getpid(), self._done


class Failing:
    """Work that raises the first times or always; a file counts the calls of all processes."""

    def __init__(self, calls: Path, error: Exception, times: int) -> None:
        self._calls, self._error, self._times = calls, error, times

    def __call__(self, unit: str) -> Iterator[str]:
        yield f"{unit} begun"
        with self._calls.open("a") as calls:
            calls.write(".")
        if self._calls.stat().st_size <= self._times:
            raise self._error
        yield f"{unit} done"


def test_alone_everything_is_done_in_order() -> None:
    with worker_pool(None, Counting()) as workers:
        assert workers.cores == 1
        assert list(workers.map(range(3))) == [(os.getpid(), done) for done in (1, 2, 3)]


def test_a_killed_node_loses_and_doubles_nothing(two_nodes: TwoNodes) -> None:
    with two_nodes.killed_at_work(), worker_pool(two_nodes.address, count_to_five) as workers:
        assert workers.cores == 2
        found = list(workers.map(range(12)))
    assert sorted(found) == [(unit, k) for unit in range(12) for k in range(5)]
    for unit in range(12):
        assert [k for u, k in found if u == unit] == list(range(5)), "in the order of the work"


def test_workers_keep_their_copy_of_the_work(two_nodes: TwoNodes) -> None:
    two_nodes.set_node_count(2)
    told_to_end = signal.getsignal(signal.SIGTERM)
    with worker_pool(two_nodes.address, Counting()) as workers:
        assert signal.getsignal(signal.SIGTERM) is told_to_end
        found = list(workers.map(range(24)))
    # Each of the few processes keeps counting over the units it gets.
    processes = {process for process, _ in found}
    for each in processes:
        counts = sorted(done for process, done in found if process == each)
        assert counts == list(range(1, len(counts) + 1))
    assert len(processes) < len(found) == 24


def test_an_input_error_ends_the_run_and_is_not_tried_again(
    two_nodes: TwoNodes, tmp_path: Path
) -> None:
    two_nodes.set_node_count(2)
    calls = tmp_path / "calls"
    work = Failing(calls, WriteError("the disk is full"), times=99)
    with (
        pytest.raises(WriteError, match=r"^the disk is full$"),
        worker_pool(two_nodes.address, work) as workers,
    ):
        list(workers.map(["only"]))
    assert calls.read_text() == "."


def test_another_error_is_tried_again(two_nodes: TwoNodes, tmp_path: Path) -> None:
    two_nodes.set_node_count(2)
    work = Failing(tmp_path / "calls", OSError("the network is gone"), times=2)
    with worker_pool(two_nodes.address, work) as workers:
        assert list(workers.map(["only"])) == ["only begun", "only done"]
    always = Failing(tmp_path / "others", OSError("the network is gone"), times=99)
    with (
        pytest.raises(OSError, match=r"^the network is gone$"),
        worker_pool(two_nodes.address, always) as workers,
    ):
        list(workers.map(["only"]))
    assert (tmp_path / "others").read_text() == "." * 6


@pytest.mark.parametrize(
    ("count", "cores", "sizes"),
    [
        (0, 4, []),
        (6, 2, [3, 3]),
        (20, 2, [10, 10]),
        (100, 2, [25, 25, 13, 13, 12, 12]),
        (1000, 1, [200, 200, 200, 200, 100, 50, 25, 13, 12]),
        (101, 3, [17, 17, 17, 9, 9, 9, 8, 8, 7]),
        (3, 64, [1, 1, 1]),
    ],
)
def test_shares_are_large_first_and_complete(count: int, cores: int, sizes: list[int]) -> None:
    units = split_work(range(count), cores, min_size=8, max_size=200)
    assert [len(unit) for unit in units] == sizes
    assert [item for unit in units for item in unit] == list(range(count))


@pytest.mark.parametrize("address", ["", "ray://head:10001", "head", "local mode"])
def test_what_is_no_address_is_one_line(address: str) -> None:
    with (
        pytest.raises(InputError, match="takes local, auto or HOST:PORT"),
        worker_pool(address, count_to_five),
    ):
        pass


@pytest.mark.parametrize("address", ["127.0.0.1:1", "127.0.0.1:99999"])
def test_where_no_cluster_is(address: str) -> None:
    with (
        pytest.raises(InputError, match=f"no Ray cluster answers at {address}") as caught,
        worker_pool(address, count_to_five),
    ):
        pass
    assert "\n" not in str(caught.value)


def test_without_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with (
        pytest.raises(InputError, match=r"pip install 'objconnect\[cluster\]'"),
        worker_pool("local", count_to_five),
    ):
        pass
