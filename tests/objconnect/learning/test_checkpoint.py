"""Weights on disk: what is read, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from objconnect.learning.checkpoint import read_weights
from objconnect.scene.errors import InputError


class _Runs:
    """Unpickled, it would make a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (self.path,))


def test_checkpoint_of_a_training_script(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint_best.tar"
    content = {
        "model": {"a.weight": torch.arange(6.0).view(2, 3), "a.bias": torch.zeros(2)},
        "conf": {"model": {"name": "two_view_refiner", "output_scales": [0, 2, 4]}},
        "eval": {"median": np.float64(0.25), "single": np.float32(1), "n": np.int64(3)},
        "epoch": 3,
    }
    torch.save(content, path)
    weights = read_weights(path)
    assert set(weights.tensors) == {"a.weight", "a.bias"}
    assert weights.tensors["a.weight"][1, 2] == 5
    # As NumPy 2 writes them.
    torch.save(content, path, _use_new_zipfile_serialization=False)
    old = path.read_bytes().replace(b"numpy._core.multiarray", b"numpy.core.multiarray")
    path.write_bytes(old.replace(b"numpy.core.multiarray", b"numpy._core.multiarray"))
    assert b"numpy._core.multiarray" in path.read_bytes()
    assert set(read_weights(path).tensors) == set(weights.tensors)


def test_the_type_of_a_number_is_damaged(tmp_path: Path) -> None:
    """NumPy's own would end the process."""
    path = tmp_path / "w.pth"
    content = {"model": {"w": torch.ones(2)}, "score": np.float64(0.5)}
    torch.save(content, path, _use_new_zipfile_serialization=False)
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"NNNJ", b"NJ"))
    assert path.read_bytes() != whole
    assert set(read_weights(path).tensors) == {"w"}


def test_code_is_refused(tmp_path: Path) -> None:
    path, made = tmp_path / "checkpoint_best.tar", tmp_path / "made"
    torch.save({"model": {"a": torch.zeros(2)}, "eval": _Runs(made)}, path)
    with pytest.raises(InputError, match="cannot be read as tensors .*: it would execute getattr"):
        read_weights(path)
    assert not made.exists()
    torch.load(path, weights_only=False)
    assert made.exists(), "the file does nothing that could be refused"


@pytest.mark.parametrize("step", [b"a", b"t", b"R", b"0", b"h\x07", b"Q", b"\x8a\xff"])
def test_a_checkpoint_whose_program_makes_no_sense(tmp_path: Path, step: bytes) -> None:
    """Torch's reader of pickles raises whatever the first wrong step does: it is one error here."""
    path = tmp_path / "w.pth"
    torch.save({"model": {"w": torch.ones(2)}}, path, _use_new_zipfile_serialization=False)
    data = path.read_bytes()
    at = data.index(b"model")
    path.write_bytes(data[: at + 6] + step + data[at + 6 :])
    with pytest.raises(InputError, match="cannot be read as tensors|holds no tensors"):
        read_weights(path)
