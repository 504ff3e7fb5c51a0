from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from objconnect.localization.cache.store import Arrays, Rows, Store, write_store
from objconnect.scene.errors import InputError
from objconnect.scene.storage.scratch import scratch

# Writes one row of a file of the cache, says so, and waits.
STARTED = """
import sys, time
from pathlib import Path
import numpy as np
from objconnect.localization.cache.store import write_store

def rows():
    yield "first", {"a": np.ones(1000)}
    print(flush=True)
    time.sleep(600)

write_store(Path(sys.argv[1]), rows())
"""


def rows_of(*rows: Arrays) -> Rows:
    yield from (("", row) for row in rows)


def test_each_row_gets_its_own_back(tmp_path: Path) -> None:
    path = tmp_path / "s.h5"
    rng = np.random.default_rng(0)
    # The first has nothing, and does not know how wide its lines would be.
    arrays = [np.zeros((0, 0), "f4"), *(rng.random((n, 3), "f4") for n in (5, 0, 2))]
    write_store(path, rows_of(*({"a": a, "long b": np.arange(3 * len(a))} for a in arrays)))
    store = Store(path)
    path.unlink()  # it stays open
    assert (len(store), store.rows) == (4, {})
    for row in (3, 1, 2):
        np.testing.assert_array_equal(store.read(row, "a"), arrays[row])
        np.testing.assert_array_equal(store.read(row, "long b"), np.arange(3 * len(arrays[row])))
    assert store.read(0, "a").shape == (0, 3)


def test_damage_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "s.h5"
    write_store(path, rows_of({"a": np.ones((5, 3))}))
    with pytest.raises(InputError, match="there is no b.*delete it"):
        Store(path).read(0, "b")
    with pytest.raises(InputError, match="too narrow.*delete it"):
        Store(path).make(0, "a", refuse)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(InputError, match="damaged.*delete it"):
        Store(path)


def refuse(_: Arrays) -> None:
    raise ValueError("too narrow")


def test_a_killed_writer_leaves_nothing_that_stays(tmp_path: Path) -> None:
    path = tmp_path / "s.h5"
    with subprocess.Popen(
        [sys.executable, "-c", STARTED, str(path)], stdout=subprocess.PIPE
    ) as writer:
        assert writer.stdout is not None
        writer.stdout.readline()
        # Meanwhile another one writes beside it.
        write_store(tmp_path / "other.h5", rows_of({"a": np.ones(3)}))
        assert len(list(tmp_path.iterdir())) == 2
        os.kill(writer.pid, signal.SIGKILL)
    assert not path.exists() and len(list(tmp_path.iterdir())) == 2
    write_store(path, rows_of({"a": np.zeros(3)}))
    assert {file.name for file in tmp_path.iterdir()} == {"s.h5", "other.h5"}
    assert not Store(path).read(0, "a").any()


def test_what_fails_is_not_kept(tmp_path: Path) -> None:
    def rows() -> Rows:
        with scratch(tmp_path) as folder:
            yield "", {"a": np.ones(3)}
            (folder / "missing").read_bytes()

    with pytest.raises(InputError, match="cannot write"):
        write_store(tmp_path / "s.h5", rows())
    assert not list(tmp_path.iterdir())
