"""The Python interface: every call and type of everyday use, to be imported from one place.

Importing this module is quick: each name is loaded when it is first used, with what it needs alone.

>>> from benchmark.api import Camera
>>> Camera("PINHOLE", 640, 480, (500.0, 500.0, 320.0, 240.0)).focal
(500.0, 500.0)
"""

from __future__ import annotations

from importlib import import_module
from operator import attrgetter
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from benchmark.audit.command import audit as audit
    from benchmark.datasets.dataset import Dataset as Dataset
    from benchmark.datasets.open import open_datasets as open_datasets
    from benchmark.evaluation.evaluate import evaluate as evaluate
    from benchmark.evaluation.external_poses import score as score
    from benchmark.evaluation.starts import parse_start as parse_start
    from benchmark.forecast.command import forecast as forecast
    from benchmark.forecast.config import ForecastConfig as ForecastConfig
    from benchmark.regress import regress as regress
    from benchmark.report.leaderboard import leaderboard as leaderboard
    from benchmark.report.view import view as view
    from benchmark.results.results import Results as Results
    from benchmark.results.results_files import load as read_results  # noqa: F401
    from benchmark.tracks.command import track as track
    from benchmark.validate import validate as validate
    from objconnect.ingest.command import ingest as ingest
    from objconnect.ingest.virtual.command import photograph_orthophoto as photograph_orthophoto
    from objconnect.learning.training.command import train as train
    from objconnect.learning.training.config import TrainConfig as TrainConfig
    from objconnect.localization.pipeline.localize import localize as localize
    from objconnect.localization.pipeline.localize import open_place as open_map  # noqa: F401
    from objconnect.localization.pipeline.sequence import SequenceInputs as SequenceInputs
    from objconnect.localization.pipeline.sequence import SequenceOutput as SequenceOutput
    from objconnect.localization.pipeline.sequence import localize_sequence as localize_sequence
    from objconnect.localization.pipeline.sequence import localize_video as localize_video
    from objconnect.localization.pipeline.tracking import SequenceConfig as SequenceConfig
    from objconnect.mapping.build import build_map as build_map
    from objconnect.mapping.dense.command import dense as dense
    from objconnect.mapping.diagnosis.command import diagnose as diagnose
    from objconnect.mapping.supplement.command import supplement as supplement
    from objconnect.methods import create as create_localizer  # noqa: F401
    from objconnect.methods import trainable as trainable
    from objconnect.scene.bundle.scene import Scene as Scene
    from objconnect.scene.errors import InputError as InputError
    from objconnect.scene.exports.export import export as export
    from objconnect.scene.geometry.camera import Camera as Camera
    from objconnect.scene.geometry.pose import Pose as Pose
    from objconnect.scene.localizer import Estimate as Estimate
    from objconnect.scene.localizer import Localizer as Localizer
    from objconnect.scene.localizer import Prior as Prior
    from objconnect.scene.localizer import Query as Query
    from objconnect.scene.maps.colmap_files import read_model as read_model
    from objconnect.scene.maps.sparse_map import SparseMap as SparseMap
    from objconnect.scene.runtime.script import run_script as run_script
    from simulate.command import simulate as simulate
    from simulate.config import SimulateConfig as SimulateConfig

    open_scene = Scene.open

_MODULES = {
    # Make scenes and maps.
    "simulate": "simulate.command",
    "SimulateConfig": "simulate.config",
    "track": "benchmark.tracks.command",
    "ingest": "objconnect.ingest.command",
    "photograph_orthophoto": "objconnect.ingest.virtual.command",
    "build_map": "objconnect.mapping.build",
    "diagnose": "objconnect.mapping.diagnosis.command",
    "supplement": "objconnect.mapping.supplement.command",
    "dense": "objconnect.mapping.dense.command",
    "export": "objconnect.scene.exports.export",
    "validate": "benchmark.validate",
    "audit": "benchmark.audit.command",
    # Read what is on disk.
    "open_scene": "objconnect.scene.bundle.scene:Scene.open",
    "open_datasets": "benchmark.datasets.open",
    "open_map": "objconnect.localization.pipeline.localize:open_place",
    "read_model": "objconnect.scene.maps.colmap_files",
    "read_results": "benchmark.results.results_files:load",
    # Localize.
    "create_localizer": "objconnect.methods:create",
    "localize": "objconnect.localization.pipeline.localize",
    "localize_video": "objconnect.localization.pipeline.sequence",
    "localize_sequence": "objconnect.localization.pipeline.sequence",
    "SequenceInputs": "objconnect.localization.pipeline.sequence",
    "SequenceOutput": "objconnect.localization.pipeline.sequence",
    "SequenceConfig": "objconnect.localization.pipeline.tracking",
    "train": "objconnect.learning.training.command",
    "trainable": "objconnect.methods",
    "TrainConfig": "objconnect.learning.training.config",
    # Look ahead.
    "forecast": "benchmark.forecast.command",
    "ForecastConfig": "benchmark.forecast.config",
    # Measure and compare.
    "evaluate": "benchmark.evaluation.evaluate",
    "parse_start": "benchmark.evaluation.starts",
    "score": "benchmark.evaluation.external_poses",
    "leaderboard": "benchmark.report.leaderboard",
    "regress": "benchmark.regress",
    "view": "benchmark.report.view",
    # Write scripts.
    "run_script": "objconnect.scene.runtime.script",
    # Types.
    "Camera": "objconnect.scene.geometry.camera",
    "Dataset": "benchmark.datasets.dataset",
    "Estimate": "objconnect.scene.localizer",
    "InputError": "objconnect.scene.errors",
    "Localizer": "objconnect.scene.localizer",
    "Pose": "objconnect.scene.geometry.pose",
    "Prior": "objconnect.scene.localizer",
    "Query": "objconnect.scene.localizer",
    "Results": "benchmark.results.results",
    "Scene": "objconnect.scene.bundle.scene",
    "SparseMap": "objconnect.scene.maps.sparse_map",
}

__all__ = list(_MODULES)


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, attribute = _MODULES[name].partition(":")
    return attrgetter(attribute or name)(import_module(module))


def __dir__() -> list[str]:
    return sorted(__all__)
