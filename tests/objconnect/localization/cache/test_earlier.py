from __future__ import annotations

import resource
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from objconnect.localization.cache.array_store import ArrayStore, written_store
from objconnect.localization.cache.earlier import Earlier, key_of


def _a(store: ArrayStore, row: int) -> NDArray[Any]:
    return store.read(row, "a")


def test_earlier_arrays_are_found_by_what_they_were_made_of(tmp_path: Path) -> None:
    paths = [tmp_path / f"{name}.h5" for name in ("one", "other", "damaged", "unkeyed")]
    for path in paths[:3]:
        with written_store(path) as add:
            for row in range(3):
                add({"a": np.full((row, 2), row)}, key_of(path.stem, np.arange(row)))
    with written_store(paths[3]) as add:
        add({"a": np.ones((1, 2))})
    paths[2].write_bytes(paths[2].read_bytes()[:200])
    earlier = Earlier(ArrayStore, ArrayStore.by_key, paths)
    for name in ("one", "other"):
        for row in range(3):
            found = earlier.read(key_of(name, np.arange(row)), _a)
            assert found is not None
            np.testing.assert_array_equal(found, np.full((row, 2), row))
    assert (
        earlier.read(key_of("one", np.arange(2)), lambda store, row: store.read(row, "b")) is None
    )
    assert earlier.read(key_of("damaged", np.arange(2)), _a) is None
    assert earlier.read(key_of(""), _a) is None


def test_more_earlier_files_than_a_process_may_open(tmp_path: Path) -> None:
    paths = [tmp_path / f"{number}.h5" for number in range(60)]
    for number, path in enumerate(paths):
        with written_store(path) as add:
            add({"a": np.array([number])}, key_of(number))
    before, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    there = len(list(Path("/proc/self/fd").iterdir()))
    resource.setrlimit(resource.RLIMIT_NOFILE, (there + 30, hard))
    try:
        earlier = Earlier(ArrayStore, ArrayStore.by_key, paths)
        for number in range(60):
            found = earlier.read(key_of(number), _a)
            assert found is not None and found == [number]
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (before, hard))


def test_keys_tell_parts_apart() -> None:
    assert key_of("a", "bc") != key_of("ab", "c") != key_of("abc")
    assert key_of(np.arange(3)) != key_of(np.arange(4)) != key_of(np.arange(4.0))
    assert key_of(np.arange(8).reshape(2, 4)[:, ::2]) == key_of(np.array([[0, 2], [4, 6]]))
