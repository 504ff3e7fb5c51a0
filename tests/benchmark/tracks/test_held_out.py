"""What tracks hold out, and that training refuses it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError
from typer.testing import CliRunner

from benchmark.cli import app
from benchmark.report.board.cells import cells
from benchmark.report.board.command import board
from benchmark.report.board.runs import read_board
from benchmark.tracks.description import load_track, read_held_out, write_track
from objconnect.scene.bundle.held_out import HeldOut, refuse_held_out
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from simulate.config import SimulateConfig
from tests.benchmark.made_data import write_scene
from tests.benchmark.report.board.made_board import write_board

ROOT = Path(__file__).parents[3]
TRAINING = sorted((ROOT / "objconnect" / "learning" / "configs").glob("*.yaml"))


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return Scene.open(write_scene(tmp_path / "hamlet"))


def change(scene: Scene, **values: Any) -> Scene:
    """The scene with another manifest; its sessions are given by their conditions."""
    path = scene.path / "scene.json"
    manifest = json.loads(path.read_text())
    for session, condition in values.pop("conditions", {}).items():
        manifest["sessions"][session]["condition"] = condition
    path.write_text(json.dumps(manifest | values))
    return Scene.open(scene.path)


def test_conditions_are_held_out_by_their_words() -> None:
    held = HeldOut(conditions=("winter-fog", "spring"))
    for name in ("winter-noon-fog", "winter-dusk-fog", "spring-noon", "spring-noon-wet"):
        assert held.has_condition(name)
    for name in ("winter-noon", "autumn-morning-fog", "summer-noon", "real"):
        assert not held.has_condition(name)


@pytest.mark.parametrize(
    ("held", "values", "what"),
    [
        ({"conditions": ["winter-fog"]}, {}, None),
        (
            {"conditions": ["winter-fog"]},
            {"conditions": {"winter-grid": "winter-dusk-fog"}},
            "the condition winter-dusk-fog",
        ),
        ({"presets": ["town"]}, {}, "the preset town"),
        ({"presets": ["park"]}, {}, None),
        ({"seeds": [7]}, {}, "the seed 7"),
        ({"seeds": [8]}, {}, None),
        (
            {"lenses": ["cmu-c1"]},
            {"config": {"camera": None, "sessions": [{"camera": {"preset": "cmu-c1"}}, {}]}},
            "the lens cmu-c1",
        ),
        ({"lenses": ["cmu-c1"]}, {"config": {"camera": {"preset": "cmu-c1"}}}, "the lens cmu-c1"),
        ({"lenses": ["cmu-c1"]}, {"config": {"camera": {"model": "PINHOLE"}}}, None),
        # Photographs of a real flight are not part of a track.
        ({"conditions": ["winter"], "seeds": [7]}, {"preset": None, "seed": None}, None),
    ],
)
def test_what_a_scene_shows_is_named(
    scene: Scene, held: dict[str, Any], values: dict[str, Any], what: str | None
) -> None:
    held_out = HeldOut.model_validate(held)
    changed = change(scene, **values)
    assert held_out.find(changed.manifest) == what
    if what is None:
        refuse_held_out([changed], {"night": held_out})
    else:
        message = f"scene {scene.path} has {what}, which the track night holds out for tests"
        with pytest.raises(InputError, match=re.escape(message)):
            refuse_held_out([changed], {"night": held_out})


@pytest.mark.parametrize("option", ["--data", "--validation"])
def test_training_refuses_what_a_track_holds_out(scene: Scene, tmp_path: Path, option: str) -> None:
    """One line, exit code 2, and nothing is left behind."""
    change(scene, conditions={"summer-grid": "melt-noon-wet"})
    words = [option, str(scene.path), "--out", str(tmp_path / "run")]
    if option == "--validation":
        words += ["--data", str(write_scene(tmp_path / "other"))]
    done = CliRunner().invoke(app, ["train", "pixloc", *words])
    assert done.exit_code == 2
    (line,) = done.stderr.strip().splitlines()
    assert line.endswith(
        f"scene {scene.path} has the condition melt-noon-wet, which the track uav-surprise "
        "holds out for tests: train on other scenes"
    )
    assert not (tmp_path / "run").exists()


def test_our_own_training_shows_nothing_that_is_held_out() -> None:
    """The scenes of ``make weights``, and those that acceptance was chosen by."""
    chosen = (ROOT / "experiments").glob("acceptance*-place.yaml")
    shown: set[str] = set()
    for path in (*TRAINING, *chosen):
        text = path.read_text()
        if "sessions:" in text:
            sessions = SimulateConfig.load(path, {}).sessions
            shown |= {session.condition for session in sessions}
    assert len(shown) > 10
    seeds = re.findall(r"\b(?:town|suburb|park|farmland|industrial|street)-(\d+)", WEIGHTS)
    assert len(seeds) > 20
    for track, held in read_held_out().items():
        assert not [name for name in shown if held.has_condition(name)], track
        assert not {int(seed) for seed in seeds} & set(held.seeds), track


WEIGHTS = (ROOT / "objconnect" / "learning" / "configs" / "weights.mk").read_text()


@pytest.mark.parametrize(("name", "least"), [("uav-surprise", 4000), ("uav-night", 1000)])
def test_the_track_shows_what_it_holds_out(name: str, least: int) -> None:
    """Half of the queries or more are of held-out conditions, and no other track shows one."""
    track = load_track(name)
    assert track.held_out is not None
    assert {place.seed for place in track.places} == set(track.held_out.seeds)
    sessions = SimulateConfig.load(Path(track.config), {}).sessions
    queries = [session for session in sessions if session.role == "query"]
    unseen = [q for q in queries if track.held_out.has_condition(q.condition)]
    assert len(track.places) * sum(q.frames or 0 for q in queries) >= least
    assert 2 * len(unseen) >= len(queries)
    for held in track.held_out.conditions:
        assert any(HeldOut(conditions=(held,)).has_condition(q.condition) for q in unseen)
    for other in ("uav-seasons", "street-seasons", "uav-small"):
        conditions = [s.condition for s in SimulateConfig.load(Path(other), {}).sessions]
        assert not [c for c in conditions if track.held_out.has_condition(c)]


@pytest.mark.parametrize(
    ("held", "says"),
    [
        ({"conditions": ["winter-eclipse"]}, "no season, light or weather 'eclipse'"),
        ({"presets": ["moon"]}, "no preset 'moon'"),
        ({"lenses": ["thermal"]}, "no lens 'thermal'"),
        ({"seeds": ["many"]}, "held_out.seeds.0"),
        ({"families": ["brick"]}, "held_out.families"),
    ],
)
def test_what_cannot_be_rendered_cannot_be_held_out(held: dict[str, Any], says: str) -> None:
    values = load_track("uav-small").model_dump() | {"held_out": held}
    with pytest.raises(ValidationError, match=re.escape(says)):
        type(load_track("uav-small")).model_validate(values)


def test_the_board_divides_queries_by_what_is_held_out(tmp_path: Path) -> None:
    made = write_board(tmp_path / "board")
    track = load_track("uav-seasons", made)
    held = HeldOut(conditions=("snow",), presets=("park",))
    write_track(track.model_copy(update={"held_out": held}), made)
    found = read_board("uav-seasons", made)
    rows = {cell.season: cell.rows for cell in cells(found.queries)}
    # Three places of eight queries a flight; park alone is held out, and summer-noon is the map's.
    assert {name: len(rows[name]) for name in rows if "seen" in name} == {
        "seen": 16,
        "unseen-condition": 16,
        "unseen-place": 8,
        "unseen-both": 8,
    }
    for name, of in rows.items():
        for query in (found.queries[k] for k in of if "seen" in name):
            assert (query.row.condition == "snow-dusk") == (
                name in ("unseen-condition", "unseen-both")
            )
            assert (query.dataset == "park-1") == (name in ("unseen-place", "unseen-both"))
    text = board(made, tmp_path / "out").text()
    for name in ("seen", "unseen-condition", "unseen-place", "unseen-both"):
        assert f"| {name} | all | objconnect |" in text
    without = write_board(tmp_path / "other")
    assert "seen" not in {cell.season for cell in cells(read_board("uav-seasons", without).queries)}
