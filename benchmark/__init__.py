"""Benchmark of localizers: data sets, evaluation, scores, leaderboards, and the command line.

The functions of everyday use, such as ``benchmark.evaluate`` and ``benchmark.leaderboard``, are
attributes of this package and are imported at their first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from objconnect.scene.runtime.lazy import lazy_attributes

if TYPE_CHECKING:
    from benchmark.auditing.command import audit as audit
    from benchmark.datasets.dataset import Dataset as Dataset
    from benchmark.datasets.open import open_datasets as open_datasets
    from benchmark.evaluation.evaluate import evaluate as evaluate
    from benchmark.evaluation.external_poses import score as score
    from benchmark.evaluation.starts import parse_start as parse_start
    from benchmark.forecasting.command import forecast as forecast
    from benchmark.forecasting.config import ForecastConfig as ForecastConfig
    from benchmark.gate.scene import gate_scene as gate_scene
    from benchmark.publishing.command import publish as publish
    from benchmark.publishing.description import Release as Release
    from benchmark.publishing.weights.command import publish_weights as publish_weights
    from benchmark.regression import regress as regress
    from benchmark.report.leaderboard import leaderboard as leaderboard
    from benchmark.report.view import view as view
    from benchmark.results.results import Results as Results
    from benchmark.results.results_files import load as read_results  # noqa: F401
    from benchmark.submissions.command import submission as submission
    from benchmark.tracks.command import track as track
    from benchmark.validation import validate as validate

_TARGETS = {
    # Data sets.
    "track": "benchmark.tracks.command",
    "open_datasets": "benchmark.datasets.open",
    "gate_scene": "benchmark.gate.scene",
    "validate": "benchmark.validation",
    "audit": "benchmark.auditing.command",
    "Dataset": "benchmark.datasets.dataset",
    # Publish.
    "publish": "benchmark.publishing.command",
    "publish_weights": "benchmark.publishing.weights.command",
    "Release": "benchmark.publishing.description",
    # Run and score.
    "evaluate": "benchmark.evaluation.evaluate",
    "parse_start": "benchmark.evaluation.starts",
    "score": "benchmark.evaluation.external_poses",
    # Compare.
    "read_results": "benchmark.results.results_files:load",
    "Results": "benchmark.results.results",
    "leaderboard": "benchmark.report.leaderboard",
    "regress": "benchmark.regression",
    "submission": "benchmark.submissions.command",
    "view": "benchmark.report.view",
    # Plan flights.
    "forecast": "benchmark.forecasting.command",
    "ForecastConfig": "benchmark.forecasting.config",
}

__all__ = list(_TARGETS)

__getattr__, __dir__ = lazy_attributes(__name__, _TARGETS)
