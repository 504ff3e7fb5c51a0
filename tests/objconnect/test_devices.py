"""Every tensor is made on the device that is asked for, and answers are the same on all.

``tests.second_device`` refuses tensors of two devices, and computes the same bits on both.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from benchmark.cli import app
from benchmark.gate.scene import GATE_SCENES
from objconnect.learning.training.config import TrainConfig
from objconnect.localization.align import descent, linearise
from objconnect.mapping.dense import patchmatch
from objconnect.mapping.dense.command import dense
from objconnect.mapping.dense.patchmatch import consistent_estimate, first_estimate
from objconnect.methods import create, trainable
from objconnect.network.landmarks import merge
from objconnect.network.object_matching import ObjectMatcher
from objconnect.network.scene_landmarks import find_landmarks
from objconnect.scene.config import load_config
from objconnect.scene.errors import InputError
from objconnect.scene.localizer import Estimate, Prior, Query, Status
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.device import torch_device
from tests.baselines.pixloc.made_map import (
    CAMERA,
    looking_down,
    photograph,
    write_map,
    write_network,
)
from tests.objconnect.learning.training.made_pairs import pairs
from tests.objconnect.mapping.dense.made_views import REFERENCE, SOURCES, inverse_depth_at
from tests.objconnect.mapping.dense.test_patchmatch import some_seeds
from tests.objconnect.network import test_landmarks, test_object_matching
from tests.second_device import second_device

GATE = GATE_SCENES["gate"]


@pytest.fixture(autouse=True)
def _no_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """The machine has no second device but the one of the tests, which changes nothing here."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    torch_device.cache_clear()


def test_auto_is_what_torch_finds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Configurations keep what they chose, so that results and cards record it."""
    assert TrainConfig().device == "cpu"
    assert create("d2net", {}).config.model_dump()["device"] == "cpu"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert TrainConfig().device == "cuda"
    assert TrainConfig(device="cuda:1").device == "cuda:1"
    with pytest.raises(InputError, match=r"^bad value for 'device'.*cuda:0 to cuda:1"):
        load_config(TrainConfig, None, {"device": "cuda:2"})


def test_the_device_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO"):
        torch_device("auto"), torch_device("auto")
    assert [record.message for record in caplog.records] == ["computing on cpu"]


@pytest.mark.parametrize("method", ["objconnect", "pixloc", "pixloc-search", "d2net", "place"])
def test_a_method_without_its_device_is_refused(method: str) -> None:
    with pytest.raises(InputError, match="^bad value for 'device'.*torch finds no CUDA device"):
        create(method, {"device": "cuda"})


@pytest.mark.parametrize(
    "words",
    [
        ("evaluate", str(GATE), "--method", "pixloc", "--set", "device=cuda", "--out", "OUT"),
        ("train", "pixloc", "--data", str(GATE), "--set", "device=cuda", "--out", "OUT"),
    ],
)
def test_commands_say_in_one_line_that_there_is_no_device(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    out = str(tmp_path / "out")
    answer = CliRunner().invoke(app, [out if word == "OUT" else word for word in words])
    (line,) = answer.output.splitlines()
    assert answer.exit_code == 2 and "bad value for 'device' on the command line: torch" in line


def test_calls_say_that_there_is_no_device(tmp_path: Path) -> None:
    for call in (dense, find_landmarks):
        with pytest.raises(InputError, match="^device 'cuda': torch finds no CUDA device"):
            call(tmp_path, device="cuda")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[SparseMap, Path]:
    folder = tmp_path_factory.mktemp("map")
    write_network(folder / "network.safetensors")
    return write_map(folder / "images"), folder


SLIM = {"precision": "float32", "weights": "network.safetensors"}


@pytest.mark.parametrize(
    ("method", "settings"),
    [
        ("pixloc", SLIM),
        pytest.param("pixloc-search", SLIM | {"matches": None}, marks=pytest.mark.thorough),
        pytest.param("place", {"precision": "float32"}, marks=pytest.mark.thorough),
        pytest.param(
            "objconnect", {"precision": "float32", "matches": None}, marks=pytest.mark.thorough
        ),
    ],
)
def test_poses_are_those_of_the_processor(
    method: str,
    settings: dict[str, Any],
    made: tuple[SparseMap, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By torch alone, as compiled loops round otherwise."""
    for module in (descent, linearise):
        monkeypatch.setattr(module, "can_be_compiled", lambda cost: False)
    sparse_map, folder = made
    own = {name: folder / value if name == "weights" else value for name, value in settings.items()}
    start = looking_down(12.5, 0.4, (1, 2, 3))
    prior = Prior(
        start.centre().numpy(),
        np.full(3, 1.0),
        cam_from_world_rotation=start.rotation.numpy(),
        attitude_sigma_deg=3.0,
    )
    query = Query("query", photograph(looking_down(12.0, 0.0)), CAMERA, prior)

    def answer(device: str) -> Estimate:
        localizer = create(method, own | {"device": device})
        localizer.prepare(sparse_map, folder / "images", tmp_path / device[:4])
        return localizer.localize(query)

    here = answer("cpu")
    with second_device():
        there = answer("cuda:0")
    assert here.status is there.status is Status.OK, (here.reason, there.reason)
    assert here.cam_from_world is not None and there.cam_from_world is not None
    assert torch.equal(here.cam_from_world.matrix(), there.cam_from_world.matrix())
    if method != "place":
        np.testing.assert_array_equal(here.covariance, there.covariance)
        assert (here.probability, here.iterations) == (there.probability, there.iterations)


def test_objects_connect_as_on_the_processor() -> None:
    xyz, vectors = test_landmarks.things(count=60)
    landmarks = merge(test_landmarks.views(xyz, vectors))[0]
    view = test_landmarks.photograph((12.0, -8.0, 80.0), (0.0, 0.0, 0.3), xyz, vectors)

    def run_connector(device: str) -> list[torch.Tensor]:
        graph = test_object_matching.graph(layers=1).to(device)
        connect = ObjectMatcher(graph, landmarks, test_landmarks.GROUND)
        camera, attitudes = test_landmarks.CAMERA, [test_landmarks.DOWN]
        candidates = connect(view.detections, camera, attitudes, test_object_matching.ANY)
        return [candidate.pose.matrix() for candidate in candidates]

    here = run_connector("cpu")
    with second_device():
        there = run_connector("cuda:0")
    assert here and all(torch.equal(*both) for both in zip(here, there, strict=True))


def test_depth_maps_are_those_of_the_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(patchmatch, "supports_loops", lambda device: False)
    monkeypatch.setattr(patchmatch, "_FIRST_ROUNDS", 1)

    def planes(device: str) -> torch.Tensor:
        views = [replace(v, grey=v.grey.to(device)) for v in (REFERENCE, *SOURCES)]
        random = torch.Generator().manual_seed(0)
        first = first_estimate(views[0], views[1:], some_seeds(12), random)
        maps = [inverse_depth_at(view).float().to(device) for view in SOURCES]
        last = consistent_estimate(views[0], views[1:], first.planes, maps, random)
        return last.planes.cpu()

    here = planes("cpu")
    with second_device():
        assert torch.equal(planes("cuda:0"), here)


@pytest.mark.parametrize(
    ("method", "network"),
    [("pixloc", {}), ("objconnect", {"segment_side": 16, "pyramid": 16}), ("d2net", {})],
)
def test_losses_are_those_of_the_processor(
    method: str, network: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In single precision, as half of it rounds otherwise."""
    monkeypatch.setattr(torch, "autocast", lambda *_: nullcontext())
    config = TrainConfig(width=0.05, warm_up=0.0, network=network)

    def loss(device: torch.device) -> float:
        training = trainable(method)(config)
        training.network.to(device).eval()
        torch.manual_seed(0)
        with torch.no_grad():
            return float(training.loss(pairs().to(device), 1.0)[0])

    here = loss(torch.device("cpu"))
    with second_device() as cuda:
        assert loss(cuda) == pytest.approx(here, rel=1e-6)
