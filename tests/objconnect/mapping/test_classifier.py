"""The classifier of places learns from towns whose objects are known."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from objconnect.learning.checkpoint import read_weights, write_weights
from objconnect.mapping.supplement.classifier import (
    NUM_FEATURES,
    SHIPPED,
    PointClassifier,
    read_classifier,
)
from objconnect.mapping.supplement.learning import (
    TrainingData,
    main,
    read_training_data,
    report,
    train_classifier,
)
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError


def make(seed: int, count: int = 3000) -> TrainingData:
    """Return places that are on objects where two features together say so."""
    rng = np.random.default_rng(seed)
    features = rng.normal(3, 5, (count, NUM_FEATURES)).astype(np.float32)
    on_object = (features[:, 0] - 3) * (features[:, 4] - 3) > 0
    small = np.where(on_object, rng.integers(1, 9, count), 0)
    return TrainingData(features, on_object, small, frozenset(range(1, 9)))


def test_it_learns_what_only_features_together_say() -> None:
    judge = train_classifier([make(seed) for seed in range(5)], steps=1000)
    other = make(2)
    right = (judge.predict(other.features) > 0.5) == other.on_object
    assert right.mean() > 0.85
    assert "8 of 8 small objects" in report(judge, other)[-1]
    blind = report(PointClassifier().eval(), other._replace(on_object=np.zeros(3000, bool)))
    assert blind[0].startswith("95% of 0 points") and "0 of 8" in blind[0]


def test_the_same_seed_learns_the_same() -> None:
    first, second = (train_classifier([make(0)], steps=20, seed=3).state_dict() for _ in range(2))
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_a_rendered_town_teaches(rendered: Scene) -> None:
    found = read_training_data(rendered.path)
    assert found.features.shape == (len(found.on_object), NUM_FEATURES)
    assert np.isfinite(found.features).all()
    assert found.on_object.any() and not found.on_object.all()
    assert found.on_object[found.small > 0].all()
    # A classifier that was trained elsewhere recognises objects here.
    likely = read_classifier().predict(found.features)
    assert likely[found.on_object].mean() > likely[~found.on_object].mean() + 0.3


def test_a_judge_of_other_features_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "judge.safetensors"
    write_weights(path, PointClassifier(), {"figures": 3})
    with pytest.raises(InputError, match="is not a classifier of this version"):
        read_classifier(path)
    with pytest.raises(InputError, match="no points to train on"):
        train_classifier([make(0, 0)])
    assert read_weights(SHIPPED).config == {"figures": NUM_FEATURES}


def test_scenes_that_are_none_are_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "judge.safetensors"
    monkeypatch.setattr(sys, "argv", ["learning", str(tmp_path / "none"), "--out", str(out)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ") and said.count("\n") == 1
    assert not out.exists()
