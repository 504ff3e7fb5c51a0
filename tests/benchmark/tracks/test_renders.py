from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.tracks.renders import (
    Render,
    difference,
    read_render,
    render_of,
    write_render,
)
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.storage.images import read_rgb


@pytest.fixture(scope="module")
def render(rendered: Scene) -> Render:
    return render_of(rendered)


def change(render: Render, row: int, **fields: object) -> Render:
    """The record with some fields of one frame replaced."""
    frames = list(render.frames)
    frames[row] = frames[row].model_copy(update=fields)
    return render.model_copy(update={"frames": tuple(frames)})


def brighter(render: Render, row: int, block: int, levels: float) -> Render:
    blocks = list(render.frames[row].blocks)
    blocks[block] += levels
    return change(render, row, blocks=tuple(blocks))


def move(render: Render, row: int, metres: float) -> Render:
    pose = list(render.frames[row].cam_from_world)
    pose[3] += metres
    return change(render, row, cam_from_world=tuple(pose))


def test_a_record_has_every_frame(rendered: Scene, render: Render) -> None:
    listed = [name for session in rendered.sessions for name in rendered.frames(session).names]
    assert [frame.name for frame in render.frames] == listed
    assert render.map_points == len(rendered.sparse_map().xyz) > 0


def test_blocks_are_means(rendered: Scene, render: Render) -> None:
    frame = render.frames[0]
    grey = read_rgb(rendered.images_root / frame.name).mean(-1)
    height, width = grey.shape
    assert not height % 8 and not width % 8, "or the test is wrong"
    means = grey.reshape(8, height // 8, 8, width // 8).mean((1, 3))
    np.testing.assert_allclose(np.reshape(frame.blocks, (8, 8)), means, atol=0.051)


def test_a_record_survives_writing_and_reading(render: Render, tmp_path: Path) -> None:
    path = tmp_path / "renders" / "town-11.json.xz"
    write_render(path, render)
    assert read_render(path) == render
    assert path.stat().st_size < 400 * len(render.frames)


def test_rounding_is_alike(render: Render) -> None:
    assert difference(render, render) == ""
    assert difference(render, brighter(render, 2, 5, 0.4)) == ""
    assert difference(render, move(render, 2, 5e-6)) == ""
    camera = Camera.parse(render.frames[2].camera.split())
    focal = float(np.nextafter(camera.params[0], np.inf))
    rounded = replace(camera, params=(focal, *camera.params[1:]))
    assert str(rounded) != str(camera)
    assert difference(render, change(render, 2, camera=str(rounded))) == ""
    points = render.map_points + int(0.01 * render.map_points)
    assert difference(render, render.model_copy(update={"map_points": points})) == ""


def test_differences_are_named(render: Render) -> None:
    name = render.frames[2].name
    said = difference(render, brighter(render, 2, 5, -0.7))
    assert said == f"{name} differs by 0.7 grey levels"
    assert difference(render, move(render, 2, 1e-3)) == f"another pose of {name}"
    for camera in ("PINHOLE 96 96 100.001 100 48 48", "PINHOLE 96 98 100 100 48 48"):
        before = change(render, 2, camera="PINHOLE 96 96 100 100 48 48")
        said = difference(before, change(render, 2, camera=camera))
        assert said == f"another camera of {name}"
    assert difference(render, change(render, 2, name="x.jpg")) == "other frames"
    fewer = render.model_copy(update={"frames": render.frames[1:]})
    assert difference(render, fewer) == "other frames"
    points = 2 * render.map_points
    grown = render.model_copy(update={"map_points": points})
    assert difference(render, grown) == f"a map of {points} points, not {render.map_points}"


def test_a_damaged_record_is_named(tmp_path: Path) -> None:
    path = tmp_path / "town-11.json.xz"
    path.write_bytes(b"no record")
    with pytest.raises(InputError, match="record of a render"):
        read_render(path)
    with pytest.raises(InputError, match="record of a render"):
        read_render(tmp_path / "nowhere.json.xz")
