"""Memory of the process over many queries, one after another.

``python -m experiments.query_memory SCENE --method objconnect --cache CACHE`` repeats the queries,
or with ``--among FIRST LAST`` the queries from number FIRST to LAST - 1. It prints the resident
memory with the used and the free part of glibc's heap and the size of caches. Resident memory that
grows without the used part was freed and not returned to the system.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
from pathlib import Path

from benchmark.datasets.open import open_datasets
from benchmark.evaluation.starts import parse_start
from objconnect.methods import create
from objconnect.scene.runtime.memory import peak_megabytes, reset_peak, resident_bytes
from objconnect.scene.runtime.tuning import ProcessTuning
from objconnect.scene.storage.lru_cache import LruCache

_MB = 1e6


class _Heap(ctypes.Structure):
    """The result of glibc's ``mallinfo2``."""

    _fields_ = [
        (name, ctypes.c_size_t)
        for name in (
            "arena",
            "ordblks",
            "smblks",
            "hblks",
            "hblkhd",
            "usmblks",
            "fsmblks",
            "uordblks",
            "fordblks",
            "keepcost",
        )
    ]


def heap() -> tuple[float, float]:
    """Return the used and the free part of the heap, 1e6 bytes."""
    mallinfo2 = ctypes.CDLL(None).mallinfo2
    mallinfo2.restype = _Heap
    usage = mallinfo2()
    return (usage.uordblks + usage.hblkhd) / _MB, usage.fordblks / _MB


def measure_caches() -> float:
    """Return the size of all bounded caches, 1e6 bytes."""
    gc.unfreeze()  # get_objects does not list frozen objects
    return sum(each.nbytes for each in gc.get_objects() if type(each) is LruCache) / _MB


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--method", default="objconnect")
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--start", default="none")
    parser.add_argument("--queries", type=int, default=64)
    parser.add_argument("--among", type=int, nargs=2, default=(0, None))
    args = parser.parse_args()
    start = parse_start(args.start)
    (dataset,) = open_datasets(args.scene)
    sparse_map = dataset.load_map()
    method = create(args.method, {})
    method.prepare(sparse_map, dataset.images, args.cache)
    load = start.loader(dataset, sparse_map, args.cache)
    queries = dataset.queries[slice(*args.among)]
    print("query, MB: resident, most, heap in use, heap free, caches; stages", flush=True)
    for number in range(args.queries):
        query = load(queries[number % len(queries)])
        reset_peak()
        found = method.localize(query)
        stages = " ".join(f"{stage} {seconds:.1f}" for stage, seconds in found.seconds.items())
        del query
        numbers = (resident_bytes() / _MB, peak_megabytes() or 0.0, *heap(), measure_caches())
        print(number + 1, *(f"{mb:.0f}" for mb in numbers), found.status, stages, flush=True)


if __name__ == "__main__":
    with ProcessTuning():  # as the command line
        main()
