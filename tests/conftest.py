"""Settings and fixtures shared by all tests."""

from __future__ import annotations

import gc
import logging
import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import pytest
import torch
from hypothesis import settings

from objconnect.mapping.build import build_map
from objconnect.scene.bundle.pictures import draw_pictures
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.runtime.tuning import ProcessTuning
from objconnect.scene.storage.digests import FOLDER_VARIABLE
from simulate.command import simulate
from simulate.config import SimulateConfig
from simulate.render.libraries import require_libraries
from tests.blender import has_blender, require_blender
from tests.extracted import remember_features
from tests.shared import hold_lock, make_once, run_folder
from tests.two_nodes import TwoNodes

# The same examples in every run and on every machine, however slow it is.
settings.register_profile("repeatable", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("repeatable")

# The tensors of the tests are small: on a busy machine threads cost more than they bring.
torch.set_num_threads(1)

# Collected tests are a million objects that stay: the defaults visit all of them again and again.
gc.set_threshold(50_000, 20, 20)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Print the seed of the random order even with -q; let the collector skip what is collected."""
    gc.freeze()
    seed = session.config.getoption("randomly_seed", None)
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if seed is not None and reporter is not None:
        reporter.write_line(f"random order: --randomly-seed={seed}")


# Modules that take long, in the order in which processes take them: none waits at the end for the
# last one. The first renders the scene that many others need, and the second does not need it.
_LONGEST = (
    "test_finder",
    "test_matrix",
    "test_lightglue",
    "test_planted",
    "test_virtual",
    "test_pairs",
    "test_pictures",
    "test_examples",
    "test_addition",
    "test_presets",
    "test_gate",
    "test_reproduced",
    "test_mutants",
    "test_cluster",
    "test_packaging",
    "test_calibration",
    "test_prepared",
    "test_loop",
    "test_localizer",
    "test_hostile",
    "test_devices",
    "test_identity",
    "test_render",
    "test_lens",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the longest modules first, the others in their random order."""
    place = {name: k for k, name in enumerate(_LONGEST)}
    items.sort(key=lambda item: place.get(item.path.stem, len(place)))


# Environment variables that pytest and libraries set.
_SET_BY_LIBRARIES = ("PYTEST_CURRENT_TEST", "TORCHINDUCTOR_", "RAY_", "PYTHONBREAKPOINT")
# Torch installs a handler of SIGCHLD for the processes of its first data loader.
_SIGNALS = sorted(signal.valid_signals() - {getattr(signal, "SIGCHLD", None)})


def process_state() -> dict[str, Any]:
    """Return the state of the process that a test could leave changed."""
    variables = {k: v for k, v in os.environ.items() if not k.startswith(_SET_BY_LIBRARIES)}
    return {
        "working folder": Path.cwd(),
        **{f"${name}": value for name, value in variables.items()},
        # Ray adds its own folder at its first import.
        "sys.path": [path for path in sys.path if not path.endswith("thirdparty_files")],
        **{f"handler of signal {n:d}": signal.getsignal(n) for n in _SIGNALS},
        "logging": (logging.root.level, logging.root.disabled, logging.root.manager.disable),
        "torch's threads": torch.get_num_threads(),
        "torch's type": torch.get_default_dtype(),
        "torch's gradients": torch.is_grad_enabled(),
        "OpenCV's threads": cv2.getNumThreads(),
    }


@pytest.fixture(autouse=True)
def _require_unchanged_process() -> Iterator[None]:
    """Seed random numbers before each test, and require that it leaves the process unchanged."""
    # Not torch.manual_seed: before CUDA is used it notes three stacks of the caller, a millisecond.
    torch.default_generator.manual_seed(0)
    if torch.cuda.is_initialized():
        torch.cuda.manual_seed_all(0)
    cv2.setRNGSeed(0)
    before = process_state()
    yield
    after = process_state()
    changed = [name for name in before | after if before.get(name) != after.get(name)]
    assert not changed, f"the test leaves another {', '.join(changed)} behind"


@pytest.fixture(scope="session", autouse=True)
def _tune_process() -> Iterator[None]:
    """Tune the process as the command line does, but freeze no objects.

    That visits the objects of all tests, for half a second; ``test_tuning`` does it in a process of
    its own.
    """
    with ProcessTuning(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "objconnect.localization.featuremetric.localizer.freeze_objects", lambda: None
        )
        yield


@pytest.fixture(scope="session", autouse=True)
def digest_cache_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Cache digests of files in a folder of the tests instead of the user's."""
    folder = tmp_path_factory.mktemp("digests")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(FOLDER_VARIABLE, str(folder))
        yield folder


@pytest.fixture(scope="session", autouse=True)
def _skip_rendering_without_blender() -> Iterator[None]:
    """Skip tests that render if Blender's module is not installed."""
    if has_blender():
        yield
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("simulate.render.pool._BlenderProcess.__init__", require_blender)
        yield


def _set_drawing(patch: pytest.MonkeyPatch, draw: Callable[[Scene], None]) -> None:
    for module in ("simulate.command", "objconnect.mapping.build"):
        patch.setattr(f"{module}.draw_pictures", draw)


@pytest.fixture(scope="session", autouse=True)
def _leave_scenes_undrawn() -> Iterator[None]:
    """Draw the pictures of ``rendered`` alone: those of a scene take more than a second."""
    with pytest.MonkeyPatch.context() as patch:
        _set_drawing(patch, lambda _: None)
        yield


@pytest.fixture(scope="session")
def flights() -> Path:
    """Return the folder of real flights; tests that need it are skipped without it."""
    folder = os.environ.get("OBJCONNECT_FLIGHTS")
    if not folder:
        pytest.skip("OBJCONNECT_FLIGHTS is not set to a folder of real flights")
    if not Path(folder).is_dir():
        pytest.fail(f"OBJCONNECT_FLIGHTS names {folder}, which is not a folder")
    return Path(folder)


@pytest.fixture(scope="session")
def real_seasons() -> Path:
    """Return the folder of the flights of the track real-seasons; tests are skipped without it."""
    folder = os.environ.get("OBJCONNECT_REAL")
    if not folder:
        pytest.skip("OBJCONNECT_REAL is not set to the folder of the track real-seasons")
    return Path(folder)


@pytest.fixture(scope="session")
def beach(flights: Path) -> Path:
    """One real flight: photographs, maps, queries and reference poses."""
    return flights / "brighton_beach"


# Three small sessions over one small town: enough for a map and for both conditions.
RENDERED = SimulateConfig.model_validate(
    {
        "seed": 11,
        "area": 120,
        "size": 320,
        "spp": 2,
        "denoising": "high",  # the fast one leaves noise of two samples
        "sessions": [
            {"condition": "summer-noon", "flight": "nadir", "role": "map", "frames": 12},
            {"condition": "summer-noon", "flight": "nadir", "role": "query", "frames": 4},
            {"condition": "winter-dusk", "flight": "oblique", "role": "query", "frames": 3},
        ],
    }
)


@pytest.fixture(scope="session")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Return a rendered scene with its map, which other processes read at the same time.

    Tests that write into it, even a lock or a picture, use ``rendered_copy``.
    """
    require_blender()
    require_libraries()

    def make(folder: Path) -> None:
        simulate(RENDERED, folder / "hamlet")
        with pytest.MonkeyPatch.context() as patch:
            _set_drawing(patch, draw_pictures)
            build_map(folder / "hamlet")

    return Scene.open(make_once(tmp_path_factory, "rendered", make) / "hamlet")


@pytest.fixture(scope="module")
def extracted_once() -> Iterator[None]:
    """SIFT features of a picture, which are the same in every test, are extracted once."""
    with remember_features():
        yield


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a cache of maps for all modules; its files are named by digests of their inputs.

    Tests that look into a cache or change it have one of their own.
    """
    folder = run_folder(tmp_path_factory) / "map-cache"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture
def rendered_copy(rendered: Scene, tmp_path: Path) -> Path:
    """Return a copy of the rendered scene that a test may change."""
    return Path(shutil.copytree(rendered.path, tmp_path / "copy"))


@pytest.fixture(scope="module")
def two_nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TwoNodes]:
    """Start a Ray cluster on this machine, one at a time."""
    with hold_lock(tmp_path_factory, "cluster"):
        nodes = TwoNodes()
        try:
            yield nodes
        finally:
            nodes.end()
