"""The same gate as a test: `pytest`, and `pytest --update-recall` to record."""

from pathlib import Path

from benchmark.datasets.open import open_datasets
from benchmark.evaluation.evaluate import evaluate
from objconnect.methods import create


def test_recall(tmp_path, no_recall_drop):
    for dataset in open_datasets(Path("data/flight")):
        evaluate(dataset, create("sift", {}), tmp_path)
    no_recall_drop(tmp_path, Path("baseline"))
