"""What an installed package adds is found by name through the command line."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from objconnect.scene.bundle.scene import Scene
from simulate.config import SimulateConfig
from simulate.look.conditions import condition
from simulate.place.presets import preset
from tests.benchmark.made_data import write_flight
from tests.benchmark.test_cli import error_line, invoke

ENTRY_POINTS = """
[objconnect.localizers]
resting = resting_package:make
[objconnect.trainables]
resting = resting_package:Training
[objconnect.exports]
names = resting_package:write
faulty = resting_package:fails
missing = resting_package:nothing
[objconnect.datasets]
parcel = resting_package:PARCEL
[objconnect.presets]
hamlet = resting_package:HAMLET
[objconnect.seasons]
monsoon = resting_package:MONSOON
"""
CODE = """
from baselines.pixloc.training import PixlocTraining
from baselines.prior import PriorConfig, PriorLocalizer
from benchmark.datasets.flight import open_flight
from objconnect.scene.config import load_config
from simulate.look.conditions import SEASONS
from simulate.place.presets import PRESETS

class Resting(PriorLocalizer):
    name = "resting"

def make(overrides):
    return Resting(load_config(PriorConfig, None, overrides))

class Training(PixlocTraining):
    pass

def write(scene, sessions, folder, final):
    names = [name for frames in sessions.values() for name in frames.names]
    (folder / "names.txt").write_text("\\n".join(names))

def fails(scene, sessions, folder, final):
    (folder / "half.txt").write_text("half")
    raise RuntimeError("no ink")

class Parcel:
    name = "parcel"
    holds = "parcel.txt (a parcel)"

    def recognizes(self, path):
        return (path / "parcel.txt").is_file()

    def open(self, path):
        if not (path / "parcel.txt").read_text():
            raise RuntimeError("an empty parcel")
        return open_flight(path / "meadow")

PARCEL = Parcel()
HAMLET = PRESETS["town"]
MONSOON = SEASONS["summer"]
"""


@pytest.fixture(autouse=True)
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A distribution where Python looks for installed packages."""
    site = tmp_path / "site"
    folder = site / "resting_package-0.1.dist-info"
    folder.mkdir(parents=True)
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: resting_package\nVersion: 0.1\n")
    (folder / "entry_points.txt").write_text(ENTRY_POINTS)
    (site / "resting_package.py").write_text(CODE)
    monkeypatch.syspath_prepend(site)
    yield
    sys.modules.pop("resting_package", None)
    condition.cache_clear()


@pytest.fixture
def parcel(tmp_path: Path) -> Path:
    """A data set of the package: a folder that only its reader knows, around a flight."""
    path = tmp_path / "parcel"
    write_flight(path / "meadow")
    (path / "parcel.txt").write_text("meadow")
    return path


def test_a_localizer_answers_a_data_set_of_a_reader(parcel: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = invoke("evaluate", parcel, "--method", "resting", "--out", out, "--json")
    assert result.exit_code == 0, result.stderr
    assert json.loads(result.stdout)["results"] == [str(out / "meadow" / "resting.json")]


def test_a_reader_says_what_its_folder_holds(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    words = ("evaluate", tmp_path / "other", "--method", "resting", "--out", tmp_path / "out")
    result = invoke(*words)
    assert result.exit_code == 2
    assert "nor parcel.txt (a parcel)" in error_line(result.stderr)


def test_faults_of_a_reader_are_one_line_that_names_it(parcel: Path, tmp_path: Path) -> None:
    (parcel / "parcel.txt").write_text("")
    result = invoke("evaluate", parcel, "--method", "sift", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "reader 'parcel' (resting_package:PARCEL) cannot read" in error_line(result.stderr)


def test_an_export_format_of_a_package_is_used(rendered: Scene, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = invoke("export", rendered.path, "--format", "names", "--out", out)
    assert result.exit_code == 0, result.stderr
    names = (out / "names.txt").read_text().splitlines()
    assert names == [n for session in rendered.sessions for n in rendered.frames(session).names]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("faulty", "format 'faulty' (resting_package:fails) cannot be written: RuntimeError: no"),
        ("missing", "format 'missing' (resting_package:nothing) cannot be loaded: AttributeError"),
        ("other", "'other' is not one of 'colmap', 'colmap-database', 'nerfstudio',"),
        ("other", ", 'faulty', 'missing', 'names'."),
    ],
)
def test_a_faulty_export_leaves_nothing(
    rendered: Scene, tmp_path: Path, name: str, message: str
) -> None:
    result = invoke("export", rendered.path, "--format", name, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert message in error_line(result.stderr)
    assert [path.name for path in tmp_path.iterdir()] == ["site"]


def test_a_trainable_method_of_a_package_is_trained(rendered: Scene, tmp_path: Path) -> None:
    settings = {"steps": 1, "batch": 1, "crop": 96, "points": 64, "width": 0.05, "workers": 0}
    words = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    run = tmp_path / "run"
    result = invoke("train", "resting", "--data", rendered.path, "--out", run, *words)
    assert result.exit_code == 0, result.stderr
    assert Path(result.stdout.strip()).is_file()
    assert "resting" in (run / "card.md").read_text()
    result = invoke("train", "other", "--data", rendered.path, "--out", run)
    assert "those that can: d2net, pixloc, objconnect, objects, resting" in error_line(
        result.stderr
    )


def test_a_preset_and_a_season_of_a_package_are_rendered(tmp_path: Path) -> None:
    sessions = ["monsoon-noon:nadir"]
    config = SimulateConfig.load(None, {"preset": "hamlet", "sessions": sessions})
    assert config.session_names() == ("monsoon-noon-nadir-map",)
    assert condition("monsoon-noon").time == condition("summer-noon").time
    hamlet, town = (preset(name)(1, 120.0) for name in ("hamlet", "town"))
    assert [thing.shape for thing in hamlet.objects] == [thing.shape for thing in town.objects]
    result = invoke("simulate", "--preset", "other", "--out", tmp_path / "out")
    message = error_line(result.stderr)
    assert "choose one of town, suburb, park, farmland, industrial, street, " in message
    assert ", hamlet (got 'other')" in message
