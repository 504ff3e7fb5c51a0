"""6-DoF localization of a UAV's camera in a sparse map, across seasons.

``import objconnect as oc`` gives the functions and types of everyday use. The import is quick,
because the module of a name is imported when the name is first used. Data sets, scores and
leaderboards are in ``benchmark``, rendering is in ``simulate``, methods to compare with are in
``baselines``.

>>> import objconnect as oc
>>> oc.Camera("PINHOLE", 640, 480, (500.0, 500.0, 320.0, 240.0)).focal
(500.0, 500.0)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from objconnect.scene.runtime.lazy import lazy_attributes

if TYPE_CHECKING:
    from objconnect.ingestion.command import ingest as ingest
    from objconnect.ingestion.virtual.command import photograph_orthophoto as photograph_orthophoto
    from objconnect.learning.training.command import train as train
    from objconnect.learning.training.config import TrainConfig as TrainConfig
    from objconnect.localization.pipeline.localization_map import open_map  # noqa: F401
    from objconnect.localization.pipeline.localize import localize as localize
    from objconnect.localization.pipeline.localize import localize_video as localize_video
    from objconnect.localization.pipeline.options import LocalizeOptions as LocalizeOptions
    from objconnect.localization.pipeline.tracking import SequenceConfig as SequenceConfig
    from objconnect.mapping.build import build_map as build_map
    from objconnect.mapping.dense.command import dense as dense
    from objconnect.mapping.diagnosis.command import diagnose as diagnose
    from objconnect.mapping.supplement.command import supplement as supplement
    from objconnect.methods import create as create_localizer  # noqa: F401
    from objconnect.methods import trainable as trainable
    from objconnect.scene.bundle.scene import Scene as Scene
    from objconnect.scene.config import Config as Config
    from objconnect.scene.errors import InputError as InputError
    from objconnect.scene.exports.export import export as export
    from objconnect.scene.geometry.camera import Camera as Camera
    from objconnect.scene.geometry.pose import Pose as Pose
    from objconnect.scene.localizer import Estimate as Estimate
    from objconnect.scene.localizer import Localizer as Localizer
    from objconnect.scene.localizer import PoseSource as PoseSource
    from objconnect.scene.localizer import Prior as Prior
    from objconnect.scene.localizer import Query as Query
    from objconnect.scene.localizer import Status as Status
    from objconnect.scene.localizer import Stopwatch as Stopwatch
    from objconnect.scene.maps.colmap_files import read_model as read_model
    from objconnect.scene.maps.sparse_map import SparseMap as SparseMap
    from objconnect.scene.runtime.script import run_script as run_script
    from objconnect.scene.runtime.tuning import ProcessTuning as ProcessTuning
    from objconnect.scene.storage.images import read_rgb as read_rgb

    open_scene = Scene.open

_TARGETS = {
    # Make scenes and maps.
    "ingest": "objconnect.ingestion.command",
    "photograph_orthophoto": "objconnect.ingestion.virtual.command",
    "build_map": "objconnect.mapping.build",
    "diagnose": "objconnect.mapping.diagnosis.command",
    "supplement": "objconnect.mapping.supplement.command",
    "dense": "objconnect.mapping.dense.command",
    "export": "objconnect.scene.exports.export",
    # Read what is on disk.
    "open_scene": "objconnect.scene.bundle.scene:Scene.open",
    "open_map": "objconnect.localization.pipeline.localization_map:open_map",
    "read_rgb": "objconnect.scene.storage.images",
    "read_model": "objconnect.scene.maps.colmap_files",
    # Localize.
    "create_localizer": "objconnect.methods:create",
    "localize": "objconnect.localization.pipeline.localize",
    "localize_video": "objconnect.localization.pipeline.localize",
    "LocalizeOptions": "objconnect.localization.pipeline.options",
    "SequenceConfig": "objconnect.localization.pipeline.tracking",
    # Train.
    "train": "objconnect.learning.training.command",
    "trainable": "objconnect.methods",
    "TrainConfig": "objconnect.learning.training.config",
    # Write scripts.
    "run_script": "objconnect.scene.runtime.script",
    "ProcessTuning": "objconnect.scene.runtime.tuning",
    # Types.
    "PoseSource": "objconnect.scene.localizer",
    "Camera": "objconnect.scene.geometry.camera",
    "Config": "objconnect.scene.config",
    "Estimate": "objconnect.scene.localizer",
    "InputError": "objconnect.scene.errors",
    "Localizer": "objconnect.scene.localizer",
    "Pose": "objconnect.scene.geometry.pose",
    "Prior": "objconnect.scene.localizer",
    "Query": "objconnect.scene.localizer",
    "Scene": "objconnect.scene.bundle.scene",
    "SparseMap": "objconnect.scene.maps.sparse_map",
    "Status": "objconnect.scene.localizer",
    "Stopwatch": "objconnect.scene.localizer",
}

__all__ = list(_TARGETS)

__getattr__, __dir__ = lazy_attributes(__name__, _TARGETS)
