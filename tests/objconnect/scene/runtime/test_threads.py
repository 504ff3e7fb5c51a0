"""Work in threads: in order, few at a time, and torch has the threads it had when it is done."""

from __future__ import annotations

import threading
from itertools import count

import pytest
import torch

from objconnect.scene.runtime.threads import (
    count_network_threads,
    map_in_threads,
    map_unordered,
    torch_threads,
)


@pytest.mark.parametrize("threads", [1, 3])
def test_in_order_and_few_ahead(threads: int) -> None:
    consumed, together = [], []

    def items() -> object:
        for number in count():
            consumed.append(number)
            yield number

    def work(number: int) -> int:
        together.append(torch.get_num_threads())
        return number**2

    with torch_threads(threads):
        results = map_in_threads(work, items())
        assert [next(results) for _ in range(10)] == [k**2 for k in range(10)]
        results.close()
        assert torch.get_num_threads() == threads
    assert len(consumed) <= 10 + threads + 1
    assert set(together) == {1}


def test_several_at_a_time() -> None:
    met = threading.Barrier(2, timeout=300)
    with torch_threads(2):
        assert len(list(map_in_threads(lambda _: met.wait(), range(4)))) == 4


@pytest.mark.parametrize("is_inference", [True, False])
def test_threads_are_in_the_inference_mode_of_the_caller(is_inference: bool) -> None:
    with torch_threads(2), torch.inference_mode(is_inference):
        modes = list(map_in_threads(lambda _: torch.is_inference_mode_enabled(), range(4)))
    assert modes == 4 * [is_inference]


def test_networks_run_in_few_threads() -> None:
    for threads, expected in [(1, 1), (3, 3), (64, 4)]:
        with torch_threads(threads):
            assert count_network_threads() == expected
    running = set()
    with torch_threads(8):
        list(map_in_threads(lambda _: running.add(threading.get_ident()), range(50), threads=2))
    assert len(running) <= 2


def test_an_error_ends_it() -> None:
    def work(number: int) -> int:
        if number == 2:
            raise ValueError("two")
        return number

    with torch_threads(2), pytest.raises(ValueError, match="two"):
        list(map_in_threads(work, range(100)))
    assert torch.get_num_threads() == 1


def test_finished_items_need_not_wait_for_the_first() -> None:
    first_is_consumed = threading.Event()

    def work(number: int) -> int:
        assert number or first_is_consumed.wait(300)
        return number

    results = map_unordered(work, range(2), 2)
    assert next(results) == 1  # item 0 ends only after this
    first_is_consumed.set()
    assert list(results) == [0]
    assert sorted(map_unordered(work, range(4), 2)) == [0, 1, 2, 3]


def test_after_an_error_no_item_begins() -> None:
    begun = []

    def work(number: int) -> int:
        begun.append(number)
        if number == 1:
            raise ValueError("one")
        return number

    results = map_unordered(work, range(50), 1)
    with pytest.raises(ValueError, match="one"):
        list(results)
    assert begun == [0, 1]
