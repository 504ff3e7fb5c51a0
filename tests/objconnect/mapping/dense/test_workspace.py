from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from objconnect.mapping.dense.workspace import Workspace
from objconnect.scene.errors import InputError
from objconnect.scene.maps.depth_files import read_array, write_array

ARRAY = np.arange(24, dtype=np.float32).reshape(3, 2, 4)


def test_arrays_come_back(tmp_path: Path) -> None:
    write_array(tmp_path / "a.bin", ARRAY)
    assert np.array_equal(read_array(tmp_path / "a.bin", 3), ARRAY)


def test_colmap_reads_the_same(tmp_path: Path) -> None:
    """Depth; that it reads the normals as they were meant, the fused cloud shows."""
    write_array(tmp_path / "depth.bin", ARRAY[:1])
    depth = pycolmap.DepthMap()
    depth.read(tmp_path / "depth.bin")
    assert np.array_equal(np.asarray(depth.to_array()), ARRAY[0])


@pytest.mark.parametrize(
    "damage", [lambda b: b[:-1], lambda b: b[:3], lambda b: b"", lambda b: b"x" + b]
)
def test_a_damaged_array_is_named(tmp_path: Path, damage: object) -> None:
    path = tmp_path / "a.bin"
    write_array(path, ARRAY)
    path.write_bytes(damage(path.read_bytes()))  # type: ignore[operator]
    with pytest.raises(InputError, match=r"a\.bin is damaged"):
        read_array(path, 3)


def test_a_map_is_there_once_its_depth_is(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path)
    assert not workspace.has("s/images/0.jpg", "geometric")
    workspace.write("s/images/0.jpg", "geometric", ARRAY[0], ARRAY)
    assert workspace.has("s/images/0.jpg", "geometric")
    assert not workspace.has("s/images/0.jpg", "photometric")
    assert np.array_equal(workspace.depth("s/images/0.jpg", "geometric"), ARRAY[0])
    assert np.array_equal(workspace.normals("s/images/0.jpg", "geometric"), ARRAY)


def test_lists(tmp_path: Path) -> None:
    Workspace(tmp_path).write_lists({"a": ["b", "c"], "b": ["a"]})
    assert (tmp_path / "stereo" / "patch-match.cfg").read_text() == "a\nb, c\nb\na\n"
    assert (tmp_path / "stereo" / "fusion.cfg").read_text() == "a\nb\n"
