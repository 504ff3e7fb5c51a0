"""The configuration of the views, and the refusals before any work."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest

from benchmark.forecasting.config import ForecastConfig
from benchmark.forecasting.views import views_config
from objconnect.methods import create
from objconnect.scene.bundle.manifest import write_json
from objconnect.scene.bundle.scene import MANIFEST, Scene
from objconnect.scene.config import load_config
from objconnect.scene.errors import InputError
from simulate.config import SimulateConfig
from tests.benchmark.made_data import CAMERA, write_scene
from tests.simulate.test_qgroundcontrol import PLAN
from tests.simulate.twin.made_site import rasters

SNOW = ForecastConfig(seasons=("snow-dusk", "summer-noon"), views=2)


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return Scene.open(write_scene(tmp_path / "hamlet"))


@pytest.fixture
def twin(tmp_path: Path, scene: Scene) -> Scene:
    """A scene that says it is a twin; its rasters exist, its photographs do not matter."""
    ortho, dsm = rasters(tmp_path)
    origin = scene.manifest.origin
    sessions = ["summer-noon:nadir"]
    given = {"preset": "site", "site.ortho": ortho, "site.dsm": dsm, "area": 120.0}
    made = SimulateConfig.load(None, given | {"sessions": sessions, "origin": origin._asdict()})
    return retold(
        tmp_path / "twin", scene, preset="site", config=made.model_dump(mode="json"), origin=origin
    )


def retold(path: Path, scene: Scene, **more: object) -> Scene:
    path.mkdir()
    write_json(path / MANIFEST, scene.manifest.model_copy(update=more))
    return Scene.open(path)


def plan_file(path: Path, **more: Any) -> str:
    told = copy.deepcopy(PLAN)
    told["mission"] |= more
    path.write_text(json.dumps(told))
    return f"plan={path}"


def test_views_are_sessions_of_the_twin_by_season_and_number(
    tmp_path: Path, scene: Scene, twin: Scene
) -> None:
    flight = plan_file(tmp_path / "route.plan")
    made = views_config(scene, scene.sparse_map(), flight, SNOW, twin)
    names = ("snow-dusk-1", "snow-dusk-2", "summer-noon-1", "summer-noon-2")
    assert made.session_names() == names
    assert [session.role for session in made.sessions] == ["map", "query", "query", "query"]
    assert {session.flight.kind for session in made.sessions} == {"plan"}
    assert made.area == 120.0 and made.origin == scene.manifest.origin
    assert made.photo_camera() == CAMERA


def test_views_are_no_larger_than_asked_for(tmp_path: Path, scene: Scene, twin: Scene) -> None:
    flight = plan_file(tmp_path / "route.plan")
    small = SNOW.model_copy(update={"size": 64})
    camera = views_config(scene, scene.sparse_map(), flight, small, twin).photo_camera()
    assert max(camera.width, camera.height) == 64
    assert camera.focal[0] / camera.width == pytest.approx(CAMERA.focal[0] / CAMERA.width, rel=0.02)


def test_other_flights_are_flown_as_queries_are(scene: Scene, twin: Scene) -> None:
    made = views_config(scene, scene.sparse_map(), "nadir", SNOW, twin)
    assert made.map_plan == made.query_plan
    assert made.frames == SNOW.waypoints


@pytest.mark.parametrize(
    ("most", "flight", "said"),
    [
        (3, "plan", "waypoints, about .* trigger less often"),
        (300, "far", "lies .* m from the centre of the place"),
        (300, "wide", "photograph .* lie outside the map's square of 120 m"),
        (300, "empty", "it has no waypoints"),
        (300, "missing", "mission plan .*nowhere.plan"),
        (300, "swim", "swim"),
    ],
)
def test_flights_that_cannot_be_forecast_are_refused(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    scene: Scene,
    twin: Scene,
    most: int,
    flight: str,
    said: str,
) -> None:
    items = PLAN["mission"]["items"]
    moved = copy.deepcopy(items)
    for item in moved:
        if item.get("command") in (16, 22):
            item["params"][4] += 1.0 if flight == "far" else 0.0
            item["params"][5] *= 1.0
    if flight == "wide":
        moved[-1 if moved[-1].get("command") == 16 else 7]["params"][5] = 8.0015
    words = {
        "plan": lambda: plan_file(tmp_path / "a.plan"),
        "far": lambda: plan_file(tmp_path / "b.plan", items=moved),
        "wide": lambda: plan_file(tmp_path / "c.plan", items=moved),
        "empty": lambda: plan_file(tmp_path / "d.plan", items=[]),
        "missing": lambda: f"plan={tmp_path / 'nowhere.plan'}",
        "swim": lambda: "swim",
    }[flight]()
    monkeypatch.setattr("benchmark.forecasting.views._MOST_WAYPOINTS", most)
    with pytest.raises(InputError, match=said) as error:
        views_config(scene, scene.sparse_map(), words, SNOW, twin)
    assert "\n" not in str(error.value)


def test_only_a_twin_of_the_same_place_is_taken(tmp_path: Path, scene: Scene, twin: Scene) -> None:
    flight = plan_file(tmp_path / "route.plan")
    with pytest.raises(InputError, match="is not the twin of a site"):
        views_config(scene, scene.sparse_map(), flight, SNOW, scene)
    there = scene.manifest.origin._replace(latitude=47.01)
    other = retold(
        tmp_path / "other", scene, preset="site", config=twin.manifest.config, origin=there
    )
    with pytest.raises(InputError, match="twin of another site"):
        views_config(scene, scene.sparse_map(), flight, SNOW, other)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"seasons": ("monsoon-noon",)}, "monsoon"),
        ({"seasons": ("snow-dusk", "snow-dusk")}, "named twice"),
        ({"views": 0}, "views"),
        ({"weak": 1.0}, "weak"),
    ],
)
def test_options_that_mean_nothing_are_refused(given: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        load_config(ForecastConfig, None, given)


def test_a_method_that_nobody_knows_is_refused() -> None:
    with pytest.raises(InputError, match="unknown method 'compass'"):
        create("compass", {})
