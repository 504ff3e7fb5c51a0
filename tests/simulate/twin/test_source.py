"""Sites made of scenes: their extent, their time, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
import rasterio  # noqa: F401  it sets variables of the environment when it is first imported

from objconnect.scene.bundle.manifest import Splits, write_json
from objconnect.scene.bundle.scene import Scene, finish_scene
from objconnect.scene.errors import InputError
from simulate.command import simulate
from simulate.config import SimulateConfig
from simulate.twin.build import build_site
from simulate.twin.options import SiteConfig
from simulate.twin.source import measure_extent, open_rasters


def with_map(path: Path, names: tuple[str, ...]) -> Path:
    """Let a scene's map have these photographs alone."""
    scene = Scene.open(path)
    write_json(path / "splits.json", Splits(map=names, queries={}))
    finish_scene(path, scene.manifest)
    return path


def test_the_world_of_a_scene_stays(rendered: Scene) -> None:
    found = measure_extent(SiteConfig(scene=rendered.path))
    assert found == (rendered.manifest.origin, 120.0)
    config = SimulateConfig.load(None, {"preset": "site", "site.scene": rendered.path})
    assert (config.origin, config.area) == found


def test_a_town_becomes_a_site(rendered: Scene, tmp_path: Path) -> None:
    """The surface is the town's, in the town's world, and the time is that of its photographs."""
    site = SiteConfig(scene=rendered.path)
    world, report = build_site(site, 120.0, rendered.manifest.origin, 0, tmp_path)
    session = "summer-noon-nadir-map"
    frames = rendered.frames(session)
    with rendered.layers(session) as dense:
        depth, up = dense.read("depth", 4)[::3, ::3], dense.read("normal", 4)[::3, ::3, 2]
    camera, pose = frames.cameras[4], frames.cam_from_world[4]
    rays = camera.unproject(camera.pixel_grid()[::3, ::3])[0].numpy()
    points = (rays * depth[..., None] - pose[:3, 3]) @ pose[:3, :3]
    level = (up > 120) & (depth > 0) & (abs(points[..., :2]) < 58).all(-1)
    x, y, z = points[level].T
    off = abs(world.terrain.height(x, y) - z)
    assert level.mean() > 0.3
    assert sorted(off)[len(off) // 2] < 0.02
    assert report.sun is not None and report.sun[1] == pytest.approx(65, abs=2)
    assert not list(tmp_path.iterdir()), "the fused files were temporary"


def test_a_twin_does_not_lie_in_its_scene(rendered: Scene) -> None:
    config = SimulateConfig.load(None, {"preset": "site", "site.scene": rendered.path})
    with pytest.raises(InputError, match="lies in the scene of the site"):
        simulate(config, rendered.path / "twin")
    assert not (rendered.path / "twin").exists()


def test_few_photographs_are_refused(rendered_copy: Path, tmp_path: Path) -> None:
    names = Scene.open(rendered_copy).splits.map[:5]
    site = SiteConfig(scene=with_map(rendered_copy, names))
    with pytest.raises(InputError, match="has 5 photographs in its map, a site needs 8"):
        build_site(site, 120.0, Scene.open(rendered_copy).manifest.origin, 0, tmp_path)


def test_a_single_line_is_said(rendered_copy: Path, tmp_path: Path) -> None:
    scene = Scene.open(rendered_copy)
    every, frames = scene.splits.map, scene.frames("summer-noon-nadir-map")
    east = frames.poses.centre().numpy()[:, 0]
    # The lines of the survey run north; that of the middle is nearest to x = 0.
    order = sorted(range(len(east)), key=lambda k: abs(east[k] - east[0]))
    line = tuple(frames.names[k] for k in order if abs(east[k] - east[0]) < 5)
    assert 3 <= len(line) < 8
    site = SiteConfig(scene=with_map(rendered_copy, line))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("simulate.twin.source._MIN_PHOTOGRAPHS", 3)
        with open_rasters(site, tmp_path) as files:
            assert [note.partition(":")[0] for note in files.notes] == ["thin coverage"]
    whole = SiteConfig(scene=with_map(rendered_copy, every))
    with open_rasters(whole, tmp_path) as files:
        assert files.notes == ()
