from __future__ import annotations

import os
from pathlib import Path

import h5py
import numpy as np
import pytest

from objconnect.scene.errors import InputError
from objconnect.scene.maps.features import Features, read_features, write_features


def some_features(n: int) -> Features:
    rng = np.random.default_rng(n)
    return Features(
        rng.uniform(0, 100, (n, 2)).astype(np.float32),
        rng.uniform(1, 9, n).astype(np.float32),
        rng.integers(0, 256, (n, 128), dtype=np.uint8),
    )


def test_round_trip_with_folders_in_names_and_blank_images(tmp_path: Path) -> None:
    path = tmp_path / "features.h5"
    features = {"summer/images/0.jpg": some_features(30), "blank.jpg": some_features(0)}
    write_features(path, features)
    again = read_features(path)
    assert set(again) == set(features)
    for name, item in features.items():
        for key in ("xy", "scale", "descriptors"):
            read, written = getattr(again[name], key), getattr(item, key)
            np.testing.assert_array_equal(read, written)
            assert read.dtype == written.dtype


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"feature file .*features\.h5 is missing or damaged"):
        read_features(tmp_path / "features.h5")


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.9])
def test_a_truncated_file_is_refused(tmp_path: Path, share: float) -> None:
    path = tmp_path / "features.h5"
    write_features(path, {"a.jpg": some_features(200)})
    os.truncate(path, int(share * path.stat().st_size))
    with pytest.raises(InputError, match="missing or damaged"):
        read_features(path)


def test_another_programs_hdf5(tmp_path: Path) -> None:
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as file:
        file["names"] = [1, 2, 3]
    with pytest.raises(InputError, match="missing or damaged"):
        read_features(path)
    with h5py.File(path, "w") as file:
        file.create_group("a.jpg")["xy"] = 3.0
    with pytest.raises(InputError, match="missing or damaged"):
        read_features(path)


def test_a_failed_write_keeps_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "features.h5"
    write_features(path, {"a.jpg": some_features(3)})
    broken = Features(None, None, None)  # type: ignore[arg-type]
    with pytest.raises(TypeError):
        write_features(path, {"b.jpg": some_features(3), "c.jpg": broken})
    assert set(read_features(path)) == {"a.jpg"}
    assert os.listdir(tmp_path) == ["features.h5"]  # noqa: PTH208 - hidden files too
