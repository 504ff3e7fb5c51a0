"""The command from a rendered scene to its files, interrupted and continued."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

import benchmark.forecasting.command as command
from benchmark import ForecastConfig, forecast
from benchmark.cli import app
from benchmark.forecasting.calibration import UNCALIBRATED
from benchmark.forecasting.config import forecast_config
from benchmark.forecasting.report import Forecast
from objconnect.methods import create
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from tests.benchmark.made_data import write_scene

pytestmark = pytest.mark.usefixtures("extracted_once")

QUICK = ForecastConfig(seasons=("summer-noon", "snow-dusk"), views=1, size=96, waypoints=3)
FILES = ("forecast.geojson", "forecast.html", "forecast.json", "forecast.png", "views")


@pytest.fixture(scope="module")
def made(
    rendered: Scene, extracted_once: None, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Forecast]:
    out = tmp_path_factory.mktemp("forecast") / "out"
    return out, forecast(rendered.path, "nadir", create("sift", {}), out, QUICK)


def test_a_forecast_has_every_waypoint_and_season(made: tuple[Path, Forecast]) -> None:
    out, report = made
    assert tuple(sorted(path.name for path in out.iterdir())) == FILES
    assert len(report.waypoints) == 3 and len(report.views) == 6
    for waypoint in report.waypoints:
        assert set(waypoint.seasons) == {"summer-noon", "snow-dusk"}
        for outlook in waypoint.seasons.values():
            assert 0 < outlook.probability < 1 and 0 < outlook.false_risk < 1
            assert outlook.views == 1
    shares = {season.name: season.share for season in report.seasons}
    assert shares["summer-noon"] >= shares["snow-dusk"]
    assert max(waypoint.points for waypoint in report.waypoints) > 10
    recorded = json.loads((out / "forecast.json").read_text())
    assert recorded["config"]["views"] == 1 and recorded["method"]["name"] == "sift"
    features = json.loads((out / "forecast.geojson").read_text())["features"]
    assert sum(f["geometry"]["type"] == "Point" for f in features) == 3


def test_a_second_run_renders_nothing_and_says_the_same(
    made: tuple[Path, Forecast], rendered: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, report = made
    monkeypatch.setattr("simulate.command.render", None)
    before = (out / "forecast.json").read_bytes()
    assert forecast(rendered.path, "nadir", create("sift", {}), out, QUICK) == report
    assert (out / "forecast.json").read_bytes() == before


def test_an_interrupted_run_keeps_its_answers(
    made: tuple[Path, Forecast], rendered: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, report = made
    (out / "forecast.json").unlink()
    method = create("sift", {})
    answer, asked = method.localize, []

    def interrupt(query: object) -> object:
        asked.append(query)
        if len(asked) == 4:
            raise KeyboardInterrupt
        return answer(query)  # type: ignore[arg-type]

    monkeypatch.setattr(method, "localize", interrupt)
    with pytest.raises(KeyboardInterrupt):
        forecast(rendered.path, "nadir", method, out, QUICK)
    assert not (out / "forecast.json").exists()
    asked.clear()
    asked.extend([None] * 10)  # no second interruption
    again = forecast(rendered.path, "nadir", method, out, QUICK)
    assert len(asked) == 10 + 3, "three of six answers were kept"
    assert again.waypoints == report.waypoints


def test_other_views_in_the_folder_are_refused(
    made: tuple[Path, Forecast], rendered: Scene
) -> None:
    out, _ = made
    other = QUICK.model_copy(update={"seed": 9})
    with pytest.raises(InputError, match="another configuration"):
        forecast(rendered.path, "nadir", create("sift", {}), out, other)


def test_a_twin_that_exists_is_not_built_again(
    made: tuple[Path, Forecast], rendered: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, report = made
    monkeypatch.setattr("simulate.base_place.build_site", None)
    monkeypatch.setattr(command, "simulate", _reuse_render(out))
    again = forecast(
        rendered.path, "nadir", create("sift", {}), tmp_path / "b", QUICK, twin=out / "views"
    )
    assert again.twin == "views"
    assert [w.enu_m for w in again.waypoints] == [w.enu_m for w in report.waypoints]


def _reuse_render(out: Path) -> object:
    """Return what stands for rendering: the views of an earlier run, copied."""

    def simulate(views: object, folder: Path, jobs: int, twin: Path | None) -> Scene:
        assert twin == out / "views"
        shutil.copytree(out / "views", folder)
        return Scene.open(folder)

    return simulate


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "give the flight with --plan FILE, or with --flight"),
        (["--flight", "nadir", "--plan", "x.plan"], "give the flight"),
        (["--flight", "nadir"], "has no map yet"),
        (["--flight", "nadir", "--season", "monsoon-noon"], "no season 'monsoon'"),
        (["--flight", "nadir", "--method", "compass"], "unknown method 'compass'"),
        (["--flight", "nadir", "--start", "pairs=x"], "x"),
        (["--flight", "nadir", "--set", "colour=red"], "colour"),
        (["--flight", "nadir", "--set", "forecast.weak=2"], "weak"),
        (["--flight", "nadir", "--set", "weak=0.4"], "--set forecast.weak=VALUE"),
        (["--flight", "nadir", "--set", "forecast.colour=red"], "colour"),
        (["--flight", "nadir", "--set", "forecast.start=none"], "give --start instead"),
        (["--flight", "nadir", "--set", "ratio=high"], "ratio"),
    ],
)
def test_a_faulty_request_is_refused_in_one_line(
    tmp_path: Path, words: list[str], said: str
) -> None:
    scene = write_scene(tmp_path / "hamlet")

    shutil.rmtree(scene / "map")
    out = tmp_path / "out"
    done = CliRunner().invoke(app, ["forecast", "--map", str(scene), "--out", str(out), *words])
    assert done.exit_code == 2
    assert said in done.stderr and done.stderr.count("\n") == 1
    assert not out.exists()


def test_a_scene_without_depth_is_refused(tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "hamlet")
    with pytest.raises(InputError) as error:
        forecast(scene, "nadir", create("sift", {}), tmp_path / "out", QUICK)
    assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()


def test_outputs_lie_outside_the_scene(rendered: Scene) -> None:
    with pytest.raises(InputError, match="choose a folder outside it"):
        forecast(rendered.path, "nadir", create("sift", {}), rendered.path / "out", QUICK)


def test_a_file_of_somebody_else_is_kept(rendered: Scene, tmp_path: Path) -> None:
    (tmp_path / "forecast.html").write_text("<p>mine</p>")
    with pytest.raises(InputError, match="it is a file of another program"):
        forecast(rendered.path, "nadir", create("sift", {}), tmp_path, QUICK)
    assert (tmp_path / "forecast.html").read_text() == "<p>mine</p>"


def test_settings_are_of_the_method_as_everywhere() -> None:
    settings: dict[str, object] = {"ratio": 0.7, "forecast.weak": 0.4, "forecast.size": 96}
    config = forecast_config(settings, {"views": 3})
    assert (config.weak, config.size, config.views) == (0.4, 96, 3)
    assert settings == {"ratio": 0.7}
    assert create("sift", settings).config.model_dump()["ratio"] == 0.7


def test_a_calibration_is_of_the_usual_settings_alone() -> None:
    usual, other = create("sift", {}), create("sift", {"max_features": 500})
    assert command._calibration(usual, wanted=True).queries > 0
    assert command._calibration(usual, wanted=False) is UNCALIBRATED
    assert command._calibration(other, wanted=True) is UNCALIBRATED
