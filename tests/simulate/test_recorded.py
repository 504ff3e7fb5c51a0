"""The flight ``flown`` repeats the poses of a finished scene's photographs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from simulate.config import SimulateConfig
from simulate.planner import plan_session
from tests.simulate.towns import cached_town


def plan_poses(config: SimulateConfig) -> Any:
    world, rng = cached_town(0, 160), np.random.default_rng(0)
    return plan_session(config.sessions[0], config, config.photo_camera(), world, rng)


def configure(scene: Path, **fields: Any) -> SimulateConfig:
    session = {
        "condition": "snow-dusk",
        "role": "map",
        "flight": {"kind": "flown", "scene": scene} | fields,
    }
    return SimulateConfig.load(None, {"sessions": [session]})


def test_photographs_are_repeated_without_wind(rendered: Scene) -> None:
    names = [name for session in rendered.sessions for name in rendered.frames(session).names]
    poses = [rendered.frames(session).cam_from_world for session in rendered.sessions]
    assert_array_equal(plan_poses(configure(rendered.path)), np.concatenate(poses))
    of_map = [name in rendered.splits.map for name in names]
    assert 0 < sum(of_map) < len(names)
    chosen = configure(rendered.path, photographs="map")
    assert_array_equal(plan_poses(chosen), np.concatenate(poses)[of_map])
    others = configure(rendered.path, photographs="queries")
    assert_array_equal(plan_poses(others), np.concatenate(poses)[np.logical_not(of_map)])
    again = SimulateConfig.model_validate_json(others.model_dump_json())
    assert again == others


def test_a_flown_flight_is_a_word_of_the_command_line(rendered: Scene) -> None:
    words = [f"summer-noon:flown={rendered.path}", f"snow-dusk:flown={rendered.path}:query"]
    config = SimulateConfig.load(None, {"sessions": words})
    assert config.session_names() == ("summer-noon-flown-map", "snow-dusk-flown-query")
    assert len(plan_poses(config)) == sum(len(rendered.frames(s)) for s in rendered.sessions)


def test_what_cannot_be_repeated_is_refused(rendered_copy: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere.scene\.json"):
        configure(tmp_path / "nowhere")
    with pytest.raises(InputError, match="photographs"):
        configure(rendered_copy, photographs="some")
    config = configure(rendered_copy)
    elsewhere = config.model_copy(
        update={"origin": config.origin._replace(latitude=config.origin.latitude + 1e-3)}
    )
    with pytest.raises(InputError, match="has another origin"):
        plan_poses(elsewhere)
    manifest = rendered_copy / "scene.json"
    manifest.write_text(manifest.read_text() + "\n")
    with pytest.raises(InputError, match="has changed since the flight"):
        plan_poses(config)
