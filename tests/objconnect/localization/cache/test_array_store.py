from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from objconnect.localization.cache.array_store import ArrayStore, written_store
from objconnect.scene.errors import InputError


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
