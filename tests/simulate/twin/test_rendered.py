"""Renders of a site: depth and labels are those of its surface model in every season."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from objconnect.scene.bundle.scene import Scene
from objconnect.scene.checks.validate import validate
from objconnect.scene.errors import InputError
from simulate.base_place import base_place
from simulate.command import render_job, simulate
from simulate.config import SimulateConfig
from simulate.place.site_files import load_site
from simulate.place.world import World
from simulate.twin.report import PLACE_FILE, REPORT_FILE, SiteReport
from tests.blender import require_blender
from tests.shared import make_once
from tests.simulate.blender_checks import check_rays
from tests.simulate.twin.made_site import rasters

SESSIONS = [
    {"condition": "summer-noon", "flight": "nadir", "role": "map", "frames": 8},
    {"condition": "snow-dusk", "flight": "nadir", "role": "map", "frames": 8, "name": "again"},
    {
        "condition": "leafoff-noon-wet",
        "flight": {"kind": "nadir", "altitude_m": 40, "pitch_deg": -55},
        "role": "query",
        "frames": 4,
        "name": "tilted",
    },
]


def make_config(folder: Path, **more: object) -> SimulateConfig:
    ortho, dsm = rasters(folder)
    given = {"preset": "site", "site.ortho": ortho, "site.dsm": dsm, "area": 120.0, "size": 96}
    return SimulateConfig.load(None, given | {"spp": 1, "sessions": SESSIONS} | more)


@pytest.fixture(scope="session")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """A twin of the made site, in summer and in snow from the same places."""
    require_blender()

    def make(folder: Path) -> None:
        (folder / "rasters").mkdir()
        simulate(
            make_config(folder / "rasters", position_jitter_m=0, attitude_jitter_deg=0),
            folder / "twin",
        )

    return Scene.open(make_once(tmp_path_factory, "twin", make) / "twin")


def surface_height(world: World, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of the triangles (south-west corner to north-east), which the test makes itself."""
    nodes, last = world.terrain.nodes, len(world.terrain.nodes) - 1
    u = (x + world.terrain.half_side_m) / world.terrain.spacing_m
    v = (y + world.terrain.half_side_m) / world.terrain.spacing_m
    i, j = (np.clip(np.floor(c).astype(int), 0, last - 1) for c in (u, v))
    s, t = u - i, v - j
    a, b, c, d = nodes[j, i], nodes[j, i + 1], nodes[j + 1, i + 1], nodes[j + 1, i]
    return np.where(s >= t, a + s * (b - a) + t * (c - b), a + t * (d - a) + s * (c - d))


def rays(scene: Scene, session: str, frame: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre (3,), directions (H, W, 3) of planar depth 1, and depth (H, W) of a frame."""
    frames = scene.frames(session)
    pose, camera = frames.cam_from_world[frame], frames.cameras[frame]
    local = camera.unproject(camera.pixel_grid())[0].numpy()
    with scene.layers(session) as dense:
        depth = dense.read("depth", frame).astype(float)
    return -pose[:3, :3].T @ pose[:3, 3], local @ pose[:3, :3], depth


@pytest.mark.thorough
def test_the_place_of_a_finished_twin_is_taken_over(
    twin: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("simulate.base_place.build_site", None)
    made = SimulateConfig.model_validate(twin.manifest.config)
    world, report = base_place(made, tmp_path / "other", twin.path)
    own = load_site(twin.path / PLACE_FILE, made.seed)
    np.testing.assert_array_equal(world.terrain.nodes, own.terrain.nodes)
    assert report is not None and report.spacing_m > 0


@pytest.mark.thorough
def test_the_truth_is_valid(twin: Scene) -> None:
    report = validate(twin.path)
    assert report.ok, report.text()


@pytest.mark.thorough
@pytest.mark.parametrize(("session", "frame"), [("again", 1), ("tilted", 0)])
def test_depth_is_what_rays_meet(twin: Scene, session: str, frame: int) -> None:
    """Rays are followed over triangles of the test's own: above them before, on them at the end."""
    world = load_site(twin.path / PLACE_FILE, 0)
    start, ways, depth = rays(twin, session, frame)
    points = start + depth[..., None] * ways
    inside = (depth > 0) & (np.abs(points[..., :2]) < world.terrain.half_side_m - 0.5).all(-1)
    assert inside.mean() > 0.3
    x, y, z = points[inside].T
    off = z - surface_height(world, x, y)
    # On walls a hair of a step aside is a step in height.
    assert np.percentile(np.abs(off), 90) < 0.002
    hair = 0.01
    around = [surface_height(world, x + hair * a, y + hair * b) for a in (-1, 1) for b in (-1, 1)]
    assert ((z < np.max(around, 0) + 0.003) & (z > np.min(around, 0) - 0.003)).mean() > 0.995
    for share in np.linspace(0.3, 0.999, 40):
        at = start + share * depth[inside, None] * ways[inside]
        within = (np.abs(at[:, :2]) < world.terrain.half_side_m).all(-1)
        assert (at[within, 2] - surface_height(world, *at[within, :2].T) > -0.01).all()


@pytest.mark.thorough
def test_blender_agrees(twin: Scene, tmp_path: Path) -> None:
    made = SimulateConfig.model_validate(twin.manifest.config)
    frames = twin.frames("again")
    job = render_job(
        made, made.sessions[1], frames.cam_from_world[:2], site_path=twin.path / PLACE_FILE
    )
    with twin.layers("again") as dense:
        arrays = [{k: dense.read(k, f) for k in ("depth", "instance")} for f in range(2)]
    check_rays(job, arrays, tmp_path)


@pytest.mark.thorough
def test_the_season_changes_no_truth(twin: Scene) -> None:
    summer, snow = "summer-noon-nadir-map", "again"
    assert np.array_equal(twin.frames(summer).cam_from_world, twin.frames(snow).cam_from_world)
    with twin.layers(summer) as one, twin.layers(snow) as other:
        for layer in ("depth", "semantic", "normal", "instance"):
            for frame in range(8):
                np.testing.assert_array_equal(one.read(layer, frame), other.read(layer, frame))


@pytest.mark.thorough
def test_labels_and_normals_are_those_of_the_surface(twin: Scene) -> None:
    world = load_site(twin.path / PLACE_FILE, 0)
    start, ways, depth = rays(twin, "again", 2)
    points = start + depth[..., None] * ways
    inside = (depth > 0) & (np.abs(points[..., :2]) < world.terrain.half_side_m - 0.5).all(-1)
    with twin.layers("again") as dense:
        semantic, normal = dense.read("semantic", 2), dense.read("normal", 2) / 127
    labels = world.ground.label(points[..., 0], points[..., 1])
    assert (semantic[inside] == labels[inside]).mean() > 0.995
    assert {1, 4, 16} <= set(np.unique(semantic[inside]).tolist())
    # A step along the surface is at right angles to its normal.
    h = 0.002
    x, y = points[inside][:, 0], points[inside][:, 1]
    east = (surface_height(world, x + h, y) - surface_height(world, x - h, y)) / (2 * h)
    assert np.median(np.abs(normal[inside] @ [1, 0, 0] + normal[inside] @ [0, 0, 1] * east)) < 0.01


@pytest.mark.thorough
def test_a_report_tells_what_it_was_made_of(twin: Scene) -> None:
    report = SiteReport.model_validate_json((twin.path / REPORT_FILE).read_text())
    assert report.texel_m == pytest.approx(0.5, abs=0.01)
    assert any("shadows of the orthophoto remain" in note for note in report.notes)
    assert twin.manifest.preset == "site"
    assert set(twin.manifest.config["site"]["sha256"]) == {"ortho", "dsm"}


@pytest.mark.thorough
def test_an_interrupted_twin_goes_on_from_its_own_place(
    twin: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The files of the site are read once: what was found of them is kept."""
    out = tmp_path / "twin"
    shutil.copytree(twin.path, out)
    made = SimulateConfig.model_validate(twin.manifest.config)
    (out / "scene.json").unlink()
    (out / ".objconnect-config.json").write_text(made.model_dump_json())
    shutil.rmtree(out / "sessions" / "again")
    monkeypatch.setattr("simulate.base_place.build_site", None)
    again = simulate(made, out)
    assert again.manifest.pixels_sha256 == twin.manifest.pixels_sha256


def test_a_cluster_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cluster cannot render a site"):
        simulate(make_config(tmp_path), tmp_path / "out", cluster="local")
