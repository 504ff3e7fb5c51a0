"""The same gate as a test: `pytest`, and `pytest --update-recall` to record."""

from pathlib import Path

from benchmark.datasets.open import open_datasets
from benchmark.evaluate import evaluate
from benchmark.registry import create


def test_recall(tmp_path, no_recall_drop):
    for dataset in open_datasets(Path("data/flight")):
        evaluate(dataset, create("sift", {}), tmp_path)
    no_recall_drop(tmp_path, Path("baseline"))
