"""Work in threads: in order, few at a time, and torch has the threads it had when it is done."""

from __future__ import annotations

import threading
from itertools import count

import pytest
import torch

from objconnect.scene.runtime.threads import map_in_threads, torch_threads


@pytest.mark.parametrize("threads", [1, 3])
def test_in_order_and_few_ahead(threads: int) -> None:
    taken, together = [], []
    begun = threading.Semaphore(0)

    def items() -> object:
        for number in count():
            taken.append(number)
            yield number

    def work(number: int) -> int:
        begun.release()
        together.append(torch.get_num_threads())
        return number**2

    with torch_threads(threads):
        results = map_in_threads(work, items())
        assert [next(results) for _ in range(10)] == [k**2 for k in range(10)]
        results.close()
        assert torch.get_num_threads() == threads
    assert len(taken) <= 10 + threads + 1
    assert set(together) == {1}


def test_several_at_a_time() -> None:
    met = threading.Barrier(2, timeout=20)
    with torch_threads(2):
        assert len(list(map_in_threads(lambda _: met.wait(), range(4)))) == 4


def test_an_error_ends_it() -> None:
    def work(number: int) -> int:
        if number == 2:
            raise ValueError("two")
        return number

    with torch_threads(2), pytest.raises(ValueError, match="two"):
        list(map_in_threads(work, range(100)))
    assert torch.get_num_threads() == 1
