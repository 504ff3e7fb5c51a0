"""Threads of torch, and work in as many threads of this process."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Have torch use so many threads meanwhile, here and in threads that begin meanwhile."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def in_threads(
    work: Callable[[Item], Result], items: Iterable[Item]
) -> Generator[Result, None, None]:
    """Apply a function to items in as many threads as torch may use; yield results in order.

    Torch uses one thread for each item meanwhile. That is for many small operations, for which
    its own threads wait more than they compute.

    Args:
        work: the function; it may be called from several threads at a time.
        items: what it is applied to; they are taken as results are.
    """
    import torch

    threads = torch.get_num_threads()
    if threads <= 1:
        yield from map(work, items)
        return
    with torch_threads(1), ThreadPoolExecutor(threads) as pool:
        waiting: deque[Future[Result]] = deque()
        try:
            for item in items:
                waiting.append(pool.submit(work, item))
                if len(waiting) > threads:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)
