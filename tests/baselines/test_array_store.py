from __future__ import annotations

import resource
from pathlib import Path

import numpy as np
import pytest

from baselines.array_store import ArrayStore, Earlier, key_of, written_store
from scene.errors import InputError


def test_each_photograph_gets_its_own_back(tmp_path: Path) -> None:
    path = tmp_path / "s.h5"
    rng = np.random.default_rng(0)
    # The first has nothing, and does not know how wide its rows would be.
    arrays = [np.zeros((0, 0), "f4"), *(rng.random((n, 3), "f4") for n in (5, 0, 2))]
    with written_store(path, levels=2) as add:
        for values in arrays:
            add({"a": values, "deep/b": np.arange(len(values))})
    shelf = ArrayStore(path)
    path.unlink()  # it stays open
    assert (len(shelf), shelf.attribute("levels")) == (4, 2)
    for row in (3, 1, 2):
        np.testing.assert_array_equal(shelf.read(row, "a"), arrays[row])
        np.testing.assert_array_equal(shelf.read(row, "deep/b"), np.arange(len(arrays[row])))
    assert shelf.read(0, "a").shape == (0, 3)


def test_damage_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "s.h5"
    with written_store(path) as add:
        add({"a": np.ones((5, 3))})
    with pytest.raises(InputError, match="there is no b.*delete it"):
        ArrayStore(path).read(0, "b")
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(InputError, match="damaged.*delete it"):
        ArrayStore(path)


def test_earlier_arrays_are_found_by_what_they_were_made_of(tmp_path: Path) -> None:
    paths = [tmp_path / f"{name}.h5" for name in ("one", "other", "damaged", "unkeyed")]
    for path in paths[:3]:
        with written_store(path) as add:
            for row in range(3):
                add({"a": np.full((row, 2), row)}, key_of(path.stem, np.arange(row)))
    with written_store(paths[3]) as add:
        add({"a": np.ones((1, 2))})
    paths[2].write_bytes(paths[2].read_bytes()[:200])
    earlier = Earlier(paths)
    for name in ("one", "other"):
        for row in range(3):
            found = earlier.read(key_of(name, np.arange(row)), ["a"])
            assert found is not None
            np.testing.assert_array_equal(found["a"], np.full((row, 2), row))
    assert earlier.read(key_of("one", np.arange(2)), ["a", "b"]) is None
    assert earlier.read(key_of("damaged", np.arange(2)), ["a"]) is None
    assert earlier.read(key_of(""), ["a"]) is None


def test_more_earlier_files_than_a_process_may_open(tmp_path: Path) -> None:
    paths = [tmp_path / f"{number}.h5" for number in range(60)]
    for number, path in enumerate(paths):
        with written_store(path) as add:
            add({"a": np.array([number])}, key_of(number))
    before, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    there = len(list(Path("/proc/self/fd").iterdir()))
    resource.setrlimit(resource.RLIMIT_NOFILE, (there + 30, hard))
    try:
        earlier = Earlier(paths)
        for number in range(60):
            found = earlier.read(key_of(number), ["a"])
            assert found is not None and found["a"] == [number]
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (before, hard))


def test_keys_tell_parts_apart() -> None:
    assert key_of("a", "bc") != key_of("ab", "c") != key_of("abc")
    assert key_of(np.arange(3)) != key_of(np.arange(4)) != key_of(np.arange(4.0))
    assert key_of(np.arange(8).reshape(2, 4)[:, ::2]) == key_of(np.array([[0, 2], [4, 6]]))
