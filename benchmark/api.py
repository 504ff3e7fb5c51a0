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
    from baselines.training.command import train as train
    from baselines.training.config import TrainConfig as TrainConfig
    from benchmark.audit.command import audit as audit
    from benchmark.datasets.dataset import Dataset as Dataset
    from benchmark.datasets.open import open_datasets as open_datasets
    from benchmark.evaluate import evaluate as evaluate
    from benchmark.external_poses import score as score
    from benchmark.forecast.command import forecast as forecast
    from benchmark.forecast.config import ForecastConfig as ForecastConfig
    from benchmark.localize import localize as localize
    from benchmark.localize import open_place as open_map  # noqa: F401
    from benchmark.registry import create as create_localizer  # noqa: F401
    from benchmark.registry import trainable as trainable
    from benchmark.regress import regress as regress
    from benchmark.report.leaderboard import leaderboard as leaderboard
    from benchmark.report.view import view as view
    from benchmark.results import Results as Results
    from benchmark.results_files import load as read_results  # noqa: F401
    from benchmark.sequence import SequenceInputs as SequenceInputs
    from benchmark.sequence import SequenceOutput as SequenceOutput
    from benchmark.sequence import localize_sequence as localize_sequence
    from benchmark.sequence import localize_video as localize_video
    from benchmark.starts import parse_start as parse_start
    from benchmark.tracking import SequenceConfig as SequenceConfig
    from benchmark.tracks.command import track as track
    from benchmark.validate import validate as validate
    from dense.command import dense as dense
    from ingest.command import ingest as ingest
    from ingest.virtual.command import photograph_orthophoto as photograph_orthophoto
    from mapping.build import build_map as build_map
    from mapping.diagnosis.command import diagnose as diagnose
    from mapping.supplement.command import supplement as supplement
    from scene.bundle.scene import Scene as Scene
    from scene.errors import InputError as InputError
    from scene.exports.export import export as export
    from scene.geometry.camera import Camera as Camera
    from scene.geometry.pose import Pose as Pose
    from scene.localizer import Estimate as Estimate
    from scene.localizer import Localizer as Localizer
    from scene.localizer import Prior as Prior
    from scene.localizer import Query as Query
    from scene.maps.colmap_files import read_model as read_model
    from scene.maps.sparse_map import SparseMap as SparseMap
    from scene.runtime.script import run_script as run_script
    from simulate.command import simulate as simulate
    from simulate.config import SimulateConfig as SimulateConfig

    open_scene = Scene.open

_MODULES = {
    # Make scenes and maps.
    "simulate": "simulate.command",
    "SimulateConfig": "simulate.config",
    "track": "benchmark.tracks.command",
    "ingest": "ingest.command",
    "photograph_orthophoto": "ingest.virtual.command",
    "build_map": "mapping.build",
    "diagnose": "mapping.diagnosis.command",
    "supplement": "mapping.supplement.command",
    "dense": "dense.command",
    "export": "scene.exports.export",
    "validate": "benchmark.validate",
    "audit": "benchmark.audit.command",
    # Read what is on disk.
    "open_scene": "scene.bundle.scene:Scene.open",
    "open_datasets": "benchmark.datasets.open",
    "open_map": "benchmark.localize:open_place",
    "read_model": "scene.maps.colmap_files",
    "read_results": "benchmark.results_files:load",
    # Localize.
    "create_localizer": "benchmark.registry:create",
    "localize": "benchmark.localize",
    "localize_video": "benchmark.sequence",
    "localize_sequence": "benchmark.sequence",
    "SequenceInputs": "benchmark.sequence",
    "SequenceOutput": "benchmark.sequence",
    "SequenceConfig": "benchmark.tracking",
    "train": "baselines.training.command",
    "trainable": "benchmark.registry",
    "TrainConfig": "baselines.training.config",
    # Look ahead.
    "forecast": "benchmark.forecast.command",
    "ForecastConfig": "benchmark.forecast.config",
    # Measure and compare.
    "evaluate": "benchmark.evaluate",
    "parse_start": "benchmark.starts",
    "score": "benchmark.external_poses",
    "leaderboard": "benchmark.report.leaderboard",
    "regress": "benchmark.regress",
    "view": "benchmark.report.view",
    # Write scripts.
    "run_script": "scene.runtime.script",
    # Types.
    "Camera": "scene.geometry.camera",
    "Dataset": "benchmark.datasets.dataset",
    "Estimate": "scene.localizer",
    "InputError": "scene.errors",
    "Localizer": "scene.localizer",
    "Pose": "scene.geometry.pose",
    "Prior": "scene.localizer",
    "Query": "scene.localizer",
    "Results": "benchmark.results",
    "Scene": "scene.bundle.scene",
    "SparseMap": "scene.maps.sparse_map",
}

__all__ = list(_MODULES)


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, attribute = _MODULES[name].partition(":")
    return attrgetter(attribute or name)(import_module(module))


def __dir__() -> list[str]:
    return sorted(__all__)
