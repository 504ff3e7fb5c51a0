"""Threads of torch and of this process."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from threading import Event
from typing import Final, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")
# Maximum number of threads that run a network at a time.
_MOST_NETWORK_THREADS: Final = 4


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Set the number of torch's threads for the block, also in threads that start in it."""
    import torch

    old_count = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(old_count)


def count_network_threads() -> int:
    """Return the number of threads that may run a network at a time; each takes memory."""
    import torch

    return min(torch.get_num_threads(), _MOST_NETWORK_THREADS)


def map_in_threads(
    work: Callable[[Item], Result], items: Iterable[Item], threads: int | None = None
) -> Generator[Result, None, None]:
    """Apply a function to items in threads; yield results in order.

    Torch uses one thread per item meanwhile. This suits many small operations, for which torch's
    own threads mostly wait. If the caller is in torch's inference mode, so are the threads.

    Args:
        work: thread-safe function.
        items: items, taken as results are consumed.
        threads: number of threads; None for as many as torch may use.
    """
    import torch

    threads = threads or torch.get_num_threads()
    is_inference = torch.is_inference_mode_enabled()
    if threads <= 1:
        yield from map(work, items)
        return

    def work_in_mode(item: Item) -> Result:
        with torch.inference_mode(is_inference):
            return work(item)

    with torch_threads(1), ThreadPoolExecutor(threads) as pool:
        waiting: deque[Future[Result]] = deque()
        try:
            for item in items:
                waiting.append(pool.submit(work_in_mode, item))
                if len(waiting) > threads:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)


def map_unordered(
    work: Callable[[Item], Result], items: Sequence[Item], threads: int
) -> Generator[Result, None, None]:
    """Apply a function to items in threads; yield results as they are finished.

    After an exception no further item begins. If several items raise at once, the exception of the
    first item is raised.

    Args:
        work: thread-safe function.
        items: items.
        threads: number of items at a time.
    """
    failed = Event()

    def attempt(item: Item) -> tuple[Result, ...]:
        if failed.is_set():
            return ()
        try:
            return (work(item),)
        except BaseException:
            failed.set()
            raise

    with ThreadPoolExecutor(threads) as pool:
        try:
            order = {pool.submit(attempt, item): k for k, item in enumerate(items)}
            waiting = set(order)
            while waiting:
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                for future in sorted(done, key=order.__getitem__):
                    yield from future.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
