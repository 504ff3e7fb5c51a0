"""The fit of the acceptance model to records."""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest

from experiments.acceptance import AlignedPose, Record, _plain, fit, read
from objconnect.localization.featuremetric.acceptance import (
    AcceptanceModel,
    log_odds_of,
)
from objconnect.localization.featuremetric.evidence import Evidence
from objconnect.scene.config import load_config


def write_records(path: Path, seed: int, inliers: int) -> Path:
    """Write 60 queries, of which every second one is right and stands out."""
    rng = np.random.default_rng(seed)
    records = []
    for k in range(60):
        right = k % 2 == 0
        figures = (14.0, 0.1, 0.8) if right else (4.0, 1.5, 0.1)
        evidence = Evidence(*(float(value * rng.lognormal(0, 0.3)) for value in figures))
        pose = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        told = AlignedPose(evidence, pose, 0.1 if right else 40.0, 1.0, 0.1)
        records.append(Record(f"{k}.jpg", [told], inliers * (1 + 9 * right), right))
    path.write_text("".join(json.dumps(_plain(each)) + "\n" for each in records))
    assert read(path) == records
    return path


@pytest.mark.parametrize(("files", "inliers"), [(1, 10), (2, 10), (1, 0)])
def test_records_give_a_model(tmp_path: Path, files: int, inliers: int) -> None:
    records = [write_records(tmp_path / f"{k}.jsonl", k, inliers) for k in range(files)]
    fit(Namespace(records=records, out=tmp_path / "own.acceptance.yaml"))
    model = load_config(AcceptanceModel, tmp_path / "own.acceptance.yaml", {})
    assert model.alignment_log_odds(Evidence(14.0, 0.1, 0.8)) > log_odds_of(0.95)
    assert model.alignment_log_odds(Evidence(4.0, 1.5, 0.1)) < log_odds_of(0.05)
    if inliers:
        assert model.match_log_odds(100) > 0 > model.match_log_odds(10)
    else:
        assert model.matched == AcceptanceModel.load_beside(None).matched
