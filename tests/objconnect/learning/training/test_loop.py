from __future__ import annotations

import json
import multiprocessing
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from baselines.pixloc.training import PixlocTraining
from objconnect.learning.checkpoint import read_weights
from objconnect.learning.training.card import CARD
from objconnect.learning.training.command import train
from objconnect.learning.training.config import TrainConfig
from objconnect.learning.training.loop import LOG, WEIGHTS, _claim, _log
from objconnect.learning.training.options import PairOptions
from objconnect.learning.training.pairs import PairBatch
from objconnect.methods import TRAINABLE, trainable
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.storage.locks import write_lock

ROOT = Path(__file__).parents[4]
TINY = TrainConfig(
    steps=4,
    batch=2,
    crop=96,
    points=64,
    width=0.05,
    workers=0,
    save_every=2,
    validate_every=2,
    warm_up=0.5,
)


# Half the pairs, where nothing is said about how many there are.
ONE = TINY.model_copy(update={"batch": 1})


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Curves are drawn at every checkpoint, which takes as long as these few steps."""
    monkeypatch.setattr("objconnect.learning.training.loop.draw_curves", lambda *_: None)


class Killed(BaseException):
    """Stands for a signal that no handler catches."""


class KilledAt(PixlocTraining):
    """Dies in the middle of a step."""

    def __init__(self, config: TrainConfig, step: int) -> None:
        super().__init__(config)
        self._last = step / config.steps

    def loss(self, batch: PairBatch, progress: float) -> tuple[Tensor, dict[str, float]]:
        if progress >= self._last:
            raise Killed
        return super().loss(batch, progress)


# Their own tests take steps of both every time.
THOROUGH = dict.fromkeys(("objects", "objconnect"), pytest.mark.thorough)


@pytest.mark.parametrize(
    "method", [pytest.param(name, marks=THOROUGH.get(name, ())) for name in TRAINABLE]
)
def test_every_method_learns_and_leaves_weights_curves_and_a_card(
    method: str, rendered: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "run"
    # Two of the eight batches: the mean of several is what is logged.
    monkeypatch.setattr("objconnect.learning.training.loop._VALIDATION_BATCHES", 2)
    # The detector of objects learns on the network that comes with the project.
    on_shipped = method == "objects"
    known = {"pairs": PairOptions(objects=True)} if on_shipped else {}
    tiny = TINY.model_copy(update={"save_every": TINY.steps, **known})
    weights = train(method, trainable(method), [rendered.path], out, tiny, [rendered.path])
    assert weights == out / WEIGHTS
    found = read_weights(weights)
    assert found.config["width"] == (0.25 if on_shipped else TINY.width)
    assert all(bool(torch.isfinite(tensor).all()) for tensor in found.tensors.values())
    untrained = trainable(method)(tiny).network.state_dict()
    assert any(not torch.equal(found.tensors[name], untrained[name]) for name in untrained)
    rows = [json.loads(line) for line in (out / LOG).read_text().splitlines()]
    assert sum(any(key.startswith("val/") for key in row) for row in rows) == 2
    assert all(row["waited"] >= 0 for row in rows if "seconds" in row)
    assert (out / "curves.png").stat().st_size > 5000
    card = (out / CARD).read_text()
    assert found.sha256 in card
    assert ("outputs of blocks relative to their input" in card) == (method == "objconnect")


@pytest.mark.usefixtures("undrawn")
def test_a_killed_run_resumes_to_the_same_weights(rendered: Scene, tmp_path: Path) -> None:
    whole = train("pixloc", PixlocTraining, [rendered.path], tmp_path / "whole", ONE)
    broken = tmp_path / "broken"
    with pytest.raises(Killed):
        train("pixloc", lambda config: KilledAt(config, 3), [rendered.path], broken, ONE)
    assert not (broken / WEIGHTS).exists()
    resumed = train("pixloc", PixlocTraining, [rendered.path], broken, ONE)
    expected, found = read_weights(whole).tensors, read_weights(resumed).tensors
    for name, tensor in expected.items():
        assert torch.allclose(found[name], tensor, atol=1e-5), name
    steps = [json.loads(line)["step"] for line in (broken / LOG).read_text().splitlines()]
    assert steps == list(range(ONE.steps))


class _Bereaved(PixlocTraining):
    """Kills the processes that make pairs in the middle of a run."""

    def loss(self, batch: PairBatch, progress: float) -> tuple[Tensor, dict[str, float]]:
        if progress >= 0.5:
            for child in multiprocessing.active_children():
                os.kill(child.pid or 0, signal.SIGKILL)
        return super().loss(batch, progress)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.thorough
def test_a_killed_maker_of_pairs_is_one_line(rendered: Scene, tmp_path: Path) -> None:
    """At step 4, when pairs of the next two are made or on their way: those of the last are not."""
    config = TINY.model_copy(update={"steps": 8, "workers": 1, "warm_up": 0.0})
    with pytest.raises(InputError, match="data loading process died .*run the same command"):
        train("pixloc", _Bereaved, [rendered.path], tmp_path, config)
    assert torch.load(tmp_path / "checkpoint.pt", weights_only=True)["done"] in (4, 6)
    assert read_weights(train("pixloc", PixlocTraining, [rendered.path], tmp_path, config)).tensors
    steps = [json.loads(line)["step"] for line in (tmp_path / LOG).read_text().splitlines()]
    assert sorted(set(steps)) == list(range(8))


def test_two_trainings_do_not_write_one_folder(rendered: Scene, tmp_path: Path) -> None:
    with write_lock(tmp_path), pytest.raises(InputError, match="another run is writing"):
        train("pixloc", PixlocTraining, [rendered.path], tmp_path, TINY)
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("undrawn")
def test_the_folder_of_another_run_is_refused(rendered: Scene, tmp_path: Path) -> None:
    short = ONE.model_copy(update={"steps": 1})
    train("pixloc", PixlocTraining, [rendered.path], tmp_path, short)
    with pytest.raises(InputError, match="another config"):
        train("pixloc", PixlocTraining, [rendered.path], tmp_path, ONE)


@pytest.mark.parametrize("option", ["data", "validation"])
def test_a_scene_is_given_once(rendered: Scene, tmp_path: Path, option: str) -> None:
    """Also by another name."""
    link = tmp_path / "link"
    link.symlink_to(rendered.path)
    scenes = {"data": [rendered.path]} | {option: [rendered.path, link]}
    with pytest.raises(InputError, match=f"{rendered.path} is given 2 times: give it once"):
        train("pixloc", PixlocTraining, out=tmp_path / "run", config=TINY, **scenes)
    assert not (tmp_path / "run").exists()


@pytest.mark.usefixtures("undrawn")
def test_a_folder_of_other_files_is_refused(rendered: Scene, tmp_path: Path) -> None:
    (tmp_path / "manifest.json").write_text("{}")
    with pytest.raises(InputError, match="is not empty and not a training run: choose another"):
        train("pixloc", PixlocTraining, [rendered.path], tmp_path, TINY)
    assert [path.name for path in tmp_path.iterdir()] == ["manifest.json"]


@pytest.mark.usefixtures("undrawn")
def test_other_pictures_of_the_same_seed_are_refused(
    rendered: Scene, rendered_copy: Path, tmp_path: Path
) -> None:
    with pytest.raises(Killed):
        train("pixloc", lambda config: KilledAt(config, 3), [rendered.path], tmp_path / "run", ONE)
    manifest = json.loads((rendered_copy / "scene.json").read_text())
    name = next(name for name in manifest["sha256"] if name.endswith("frames.h5"))
    manifest["sha256"][name] = "0" * 64
    (rendered_copy / "scene.json").write_text(json.dumps(manifest))
    with pytest.raises(InputError, match="another scenes"):
        train("pixloc", PixlocTraining, [rendered_copy], tmp_path / "run", ONE)


def test_other_workers_are_the_same_run(tmp_path: Path) -> None:
    other = TINY.model_copy(update={"workers": 1, "save_every": 3})
    for config in (TINY, other):
        _claim(tmp_path, {"config": config.model_dump(mode="json")}, 0)
    with pytest.raises(InputError, match="another config"):
        changed = TINY.model_copy(update={"batch": 3})
        _claim(tmp_path, {"config": changed.model_dump(mode="json")}, 0)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.thorough
def test_a_run_goes_on_with_other_workers(rendered: Scene, tmp_path: Path) -> None:
    with pytest.raises(Killed):
        train("pixloc", lambda config: KilledAt(config, 3), [rendered.path], tmp_path, ONE)
    other = ONE.model_copy(update={"workers": 1 - min(ONE.workers, 1), "save_every": 3})
    assert train("pixloc", PixlocTraining, [rendered.path], tmp_path, other).is_file()


@pytest.mark.usefixtures("undrawn")
def test_a_damaged_checkpoint_is_named(rendered: Scene, tmp_path: Path) -> None:
    short = ONE.model_copy(update={"steps": 1})
    train("pixloc", PixlocTraining, [rendered.path], tmp_path, short)
    (tmp_path / "checkpoint.pt").write_bytes(b"PK\x03\x04 cut short")
    with pytest.raises(InputError, match=r"checkpoint.pt is damaged .* remove it"):
        train("pixloc", PixlocTraining, [rendered.path], tmp_path, short)


@pytest.mark.parametrize(
    "line",
    ["[]}", '{"loss": 1.0}', '{"step": "x"}', '{"step": 0, "loss": {}}', "[" * 9000 + "}"],
)
def test_a_damaged_log_is_named(line: str, tmp_path: Path) -> None:
    log = tmp_path / LOG
    log.write_text('{"step": 0, "loss": NaN}\n' + line + '\n{"step": 1, "lo')
    with pytest.raises(InputError, match=r"line 2 of .*log.jsonl is damaged"), _log(log, 5, 0):
        pass


def test_a_log_cut_short_goes_on(tmp_path: Path) -> None:
    log = tmp_path / LOG
    log.write_text('{"step": 0, "loss": NaN}\n{"step": 1, "loss": 1.0}\n{"step": 2, "lo')
    with _log(log, 1, 0) as write:
        write(1, {"loss": 2.0})
    assert log.read_text() == '{"step": 0, "loss": NaN}\n{"step": 1, "loss": 2.0}\n'


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"config": 3}', '"config"', "[" * 9000])
def test_a_damaged_description_is_named(text: str, tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(text)
    with pytest.raises(InputError, match=r"run.json is damaged"):
        _claim(tmp_path, {"config": TINY.model_dump(mode="json")}, 0)


def test_a_method_that_cannot_learn_is_refused() -> None:
    with pytest.raises(InputError, match="'sift' cannot be trained"):
        trainable("sift")


class _Line(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.slope = nn.Parameter(torch.zeros(1))


class _Fit:
    """The gradient of a process is its rank plus one."""

    def __init__(self, config: TrainConfig) -> None:
        self.network = _Line()
        self.network_config = config

    def loss(self, batch: PairBatch, progress: float) -> tuple[Tensor, dict[str, float]]:
        from objconnect.learning.training.loop import join

        return self.network.slope.sum() * (join(torch.device("cpu")).rank + 1.0), {}

    def groups(self, rate: float) -> list[dict[str, Any]]:
        return [{"params": list(self.network.parameters()), "lr": rate}]


@pytest.mark.slow
def test_processes_share_their_gradients(rendered: Scene, tmp_path: Path) -> None:
    script = tmp_path / "two.py"
    script.write_text(
        "import sys\n"
        "from pathlib import Path\n"
        "from objconnect.learning.training.command import train\n"
        "from tests.objconnect.learning.training.test_loop import TINY, _Fit\n"
        "train('line', _Fit, [Path(sys.argv[1])], Path(sys.argv[2]), TINY)\n"
    )
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]
    run = [*command, str(script), str(rendered.path), str(tmp_path / "run")]
    subprocess.run(
        run, check=True, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}, timeout=300
    )
    rows = (tmp_path / "run" / LOG).read_text().splitlines()
    # The mean of one and two.
    assert json.loads(rows[-1])["norm"] == pytest.approx(1.5)
