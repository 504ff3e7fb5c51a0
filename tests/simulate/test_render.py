"""Small renders, whose layers must agree with the geometry of the place."""

import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydantic import ValidationError

import simulate.render.pool
from objconnect.scene.bundle.labels import CLASSES
from objconnect.scene.errors import InputError
from simulate.camera.pinhole import PinholeCamera
from simulate.flight.config import NadirFlight, ObliqueFlight
from simulate.flight.context import FlightContext, Wind
from simulate.flight.flights import plan_nadir, plan_oblique
from simulate.place.world import MAX_OBJECT_ID, class_lookup
from simulate.render.job import RenderJob, frame_path
from simulate.render.pool import RenderError, render
from tests.simulate.blender_checks import check_rays
from tests.simulate.ground_error import ground_error
from tests.simulate.test_flights import pinhole
from tests.simulate.towns import cached_town

SEED, AREA = 5, 120.0
_PR_SET_CHILD_SUBREAPER = 36
# Off-centre and not square, so that a mistaken principal point or axis shows.
CAMERA = PinholeCamera(width=112, height=96, f=90.0, cx=52.5, cy=50.25)


def make_job(condition: str) -> RenderJob:
    town = cached_town(SEED, AREA)
    rng = np.random.default_rng(0)
    context = FlightContext(AREA, town.terrain.height, pinhole(112, 96, 90.0))
    windy = replace(context, wind=Wind(attitude_jitter_deg=3.0))
    down = plan_nadir(NadirFlight(altitude_m=50.0), windy, 2, rng)
    oblique = plan_oblique(ObliqueFlight(radius_m=45.0, altitude_m=40.0), context, 1, rng)
    poses = np.concatenate([down, oblique])
    return RenderJob(
        preset="town", seed=SEED, side_m=AREA, condition=condition, camera=CAMERA, samples=1,
        poses={i: pose.tolist() for i, pose in enumerate(poses)},
    )  # fmt: skip


def load(out: Path, frame: int) -> dict[str, np.ndarray]:
    with np.load(frame_path(out, frame)) as arrays:
        return dict(arrays)


@pytest.fixture(scope="module")
def summer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three frames, finished after an interruption by the rendering of those that are missing."""
    out = tmp_path_factory.mktemp("summer")

    def interrupt(frame: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render(make_job("summer-noon"), out, on_frame=interrupt)
    kept = {path: path.stat().st_mtime_ns for path in out.iterdir()}
    assert frame_path(out, 0) in kept
    assert frame_path(out, 2) not in kept
    seen: list[int] = []
    render(make_job("summer-noon"), out, on_frame=seen.append)
    assert seen == [frame for frame in range(3) if frame_path(out, frame) not in kept]
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    return out


def world_points(arrays: dict[str, np.ndarray], pose: list[list[float]]) -> np.ndarray:
    """World points (H, W, 3) of the pixels' centres."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width] + 0.5
    rays = np.stack([(u - CAMERA.cx) / CAMERA.f, (v - CAMERA.cy) / CAMERA.f, np.ones_like(u)], -1)
    world_from_cam = np.linalg.inv(np.array(pose))
    local = rays * arrays["depth"][..., None]
    return local @ world_from_cam[:3, :3].T + world_from_cam[:3, 3]


def test_a_frame_holds_what_is_promised(summer):
    arrays = load(summer, 0)
    shape = (CAMERA.height, CAMERA.width)
    expected = {
        "rgb": (np.uint8, (*shape, 3)),
        "depth": (np.float32, shape),
        "instance": (np.uint16, shape),
        "semantic": (np.uint8, shape),
        "normal": (np.int8, (*shape, 3)),
    }
    assert {k: (a.dtype, a.shape) for k, a in arrays.items()} == expected
    assert arrays["rgb"].std() > 10
    assert sorted(p.name for p in summer.iterdir()) == [f"{i:06d}.npz" for i in range(3)]


def render_with(folder: Path, **changed: object) -> dict[str, np.ndarray]:
    """The first frame with other settings."""
    few = make_job("summer-noon")
    render(few.model_copy(update={"poses": {0: few.poses[0]}} | changed), folder)
    return load(folder, 0)


@pytest.mark.thorough
def test_denoising_changes_the_picture_alone(summer, tmp_path):
    fast, high = load(summer, 0), render_with(tmp_path, denoising="high")
    for layer in set(fast) - {"rgb"}:
        assert np.array_equal(fast[layer], high[layer]), layer
    assert not np.array_equal(fast["rgb"], high["rgb"])


@pytest.mark.thorough
def test_a_fast_denoiser_is_nearly_as_near_to_a_picture_of_many_samples(summer, tmp_path):
    """Of one sample a pixel both are some 7 grey levels off."""
    many = render_with(tmp_path / "many", samples=256)["rgb"].astype(float)
    high = render_with(tmp_path / "high", denoising="high")["rgb"]
    fast_off, high_off = (
        np.sqrt(((rgb - many) ** 2).mean()) for rgb in (load(summer, 0)["rgb"], high)
    )
    assert 0 < fast_off < 1.1 * high_off


@pytest.mark.thorough
def test_depth_is_what_rays_meet(summer, tmp_path):
    """Against Blender's own ray casts through pixel centres, edges of objects included."""
    frames = [load(summer, frame) for frame in range(3)]
    check_rays(make_job("summer-noon"), frames, tmp_path)


def test_ground_points_lie_on_the_terrain(summer):
    town, poses = cached_town(SEED, AREA), make_job("summer-noon").poses
    for frame in poses:
        arrays = load(summer, frame)
        on_ground = (arrays["instance"] == 0) & (arrays["depth"] > 0)
        x, y, z = world_points(arrays, poses[frame])[on_ground].T
        inside = np.maximum(np.abs(x), np.abs(y)) < 0.5 * AREA
        error = ground_error(town, x, y, z)[inside]
        # Half a pixel off would be some 0.2 m in the oblique frame; what is left is the
        # triangulation of the terrain.
        assert np.median(error) < 0.002
        assert np.percentile(error, 99) < 0.02


def test_object_points_lie_in_their_boxes_and_reach_their_tops(summer):
    town, poses = cached_town(SEED, AREA), make_job("summer-noon").poses
    by_id = {o.id: o for o in town.objects}
    tops = []
    for frame in poses:
        arrays = load(summer, frame)
        world = world_points(arrays, poses[frame])
        for number in np.unique(arrays["instance"]):
            if number == 0:
                continue
            item = by_id[int(number)]
            seen = world[arrays["instance"] == number]
            local = seen - item.centre
            cos, sin = np.cos(item.yaw), np.sin(item.yaw)
            local[:, :2] = local[:, :2] @ np.array([[cos, -sin], [sin, cos]])
            below = 1.5 if item.class_name == "building" else 0.0  # foundations
            assert (np.abs(local[:, :2]) <= 0.5 * item.size[:2] + 0.03).all(), item
            assert (local[:, 2] <= 0.5 * item.size[2] + 0.03).all(), item
            assert (local[:, 2] >= -0.5 * item.size[2] - below - 0.03).all(), item
            if item.class_name in ("car", "container") and len(seen) > 12:
                tops.append(0.5 * item.size[2] - local[:, 2].max())
    assert len(tops) > 3
    assert np.median(tops) < 0.05


def test_frames_see_the_same_surface(summer):
    """Depth and poses carry pixels of one frame onto the surface another frame sees."""
    poses = make_job("summer-noon").poses
    arrays = [load(summer, i) for i in poses]
    world = world_points(arrays[0], poses[0])
    pose = np.array(poses[2])
    local = world @ pose[:3, :3].T + pose[:3, 3]
    u = CAMERA.f * local[..., 0] / local[..., 2] + CAMERA.cx
    v = CAMERA.f * local[..., 1] / local[..., 2] + CAMERA.cy
    visible = (u > 0) & (u < CAMERA.width) & (v > 0) & (v < CAMERA.height) & (local[..., 2] > 0)
    column, row = u[visible].astype(int), v[visible].astype(int)
    agree = arrays[2]["instance"][row, column] == arrays[0]["instance"][visible]
    assert visible.mean() > 0.1
    assert agree.mean() > 0.75  # the rest is hidden behind something in the other frame


def test_labels_are_consistent(summer):
    town = cached_town(SEED, AREA)
    table = class_lookup(town.objects)
    for frame in range(3):
        arrays = load(summer, frame)
        instance = arrays["instance"]
        assert instance.max() <= MAX_OBJECT_ID
        assert set(np.unique(instance)) <= {0, *(o.id for o in town.objects)}
        on_object = instance > 0
        assert np.array_equal(arrays["semantic"][on_object], table[instance[on_object]])
        assert set(np.unique(arrays["semantic"])) <= set(CLASSES.values())
        assert ((arrays["semantic"] == CLASSES["sky"]) == (arrays["depth"] == 0)).all()
        length = np.linalg.norm(arrays["normal"][arrays["depth"] > 0].astype(float), axis=-1)
        assert_allclose(length, 127, atol=2)
        # Carriageways lie flat; along their edges stand the kerbs.
        road = (arrays["semantic"] == CLASSES["road"]).astype(np.uint8)
        inside = cv2.erode(road, np.ones((3, 3), np.uint8)).astype(bool)
        assert inside.sum() > 200
        assert (arrays["normal"][inside][:, 2] > 115).all()


@pytest.mark.thorough
def test_conditions_share_their_geometry(summer, tmp_path):
    winter_job = make_job("winter-dusk")
    winter_job.poses = {i: winter_job.poses[i] for i in (0, 2)}
    seen = []
    render(winter_job, tmp_path, processes=2, on_frame=seen.append)
    assert sorted(seen) == [0, 2]
    for frame in (0, 2):
        a, b = load(summer, frame), load(tmp_path, frame)
        assert_allclose(a["depth"], b["depth"], atol=1e-4)
        assert np.array_equal(a["instance"], b["instance"])
        assert np.array_equal(a["semantic"], b["semantic"])
        difference = np.abs(a["rgb"].astype(int) - b["rgb"].astype(int))
        assert difference.mean() > 15


# In the default part the fixture renders the missing frames alone.
@pytest.mark.thorough
def test_only_missing_frames_are_rendered_again_and_come_out_the_same(summer):
    before = [load(summer, i) for i in range(3)]
    kept = frame_path(summer, 0).stat().st_mtime_ns
    frame_path(summer, 1).unlink()
    seen: list[int] = []
    render(make_job("summer-noon"), summer, on_frame=seen.append)
    assert seen == [1]
    assert frame_path(summer, 0).stat().st_mtime_ns == kept
    after = load(summer, 1)
    for name, array in before[1].items():
        assert np.array_equal(array, after[name]), name


@pytest.mark.thorough
@pytest.mark.parametrize(
    "limit", [("FRAMES_PER_PROCESS", 1), ("_MAX_GROWTH_BYTES", 0)], ids=["frames", "memory"]
)
def test_a_process_that_ends_early_is_followed_by_another(summer, tmp_path, monkeypatch, limit):
    monkeypatch.setattr(simulate.render.pool, *limit)
    started = []

    class Counted(subprocess.Popen):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            started.append(self.pid)

    monkeypatch.setattr(subprocess, "Popen", Counted)
    wanted = make_job("summer-noon")
    wanted.poses = {i: wanted.poses[i] for i in (0, 1)}
    seen: list[int] = []
    render(wanted, tmp_path, on_frame=seen.append)
    assert sorted(seen) == list(wanted.poses)
    assert len(started) == 2
    for frame in wanted.poses:
        for name, array in load(summer, frame).items():
            assert np.array_equal(array, load(tmp_path, frame)[name]), name


@contextmanager
def adopted_orphans() -> Iterator[None]:
    """Let children of ended children become children of this process, which can wait for them."""
    libc = ctypes.CDLL(None)
    libc.prctl(_PR_SET_CHILD_SUBREAPER, 1)
    try:
        yield
    finally:
        libc.prctl(_PR_SET_CHILD_SUBREAPER, 0)


def children_of(process: int) -> list[int]:
    listed = Path(f"/proc/{process}/task/{process}/children")
    return [int(child) for child in listed.read_text().split()]


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends processes with their parent")
def test_no_process_outlives_a_killed_run(tmp_path):
    """kill -9 of the parent alone: nothing goes on writing where the next run will write."""
    script = tmp_path / "run.py"
    script.write_text(
        "import sys\nfrom pathlib import Path\nfrom simulate.render.pool import RenderJob, render\n"
        "job = RenderJob.model_validate_json(Path(sys.argv[1]).read_text())\n"
        "render(job, Path(sys.argv[2]), on_frame=lambda frame: print(frame, flush=True))\n"
    )
    many = make_job("summer-noon")
    many.poses = {k: many.poses[k % 3] for k in range(500)}
    (tmp_path / "job.json").write_text(many.model_dump_json())
    words = [sys.executable, str(script), str(tmp_path / "job.json"), str(tmp_path / "out")]
    root = str(Path(__file__).parents[2])
    with (
        adopted_orphans(),
        subprocess.Popen(
            words, stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": root}
        ) as parent,
    ):
        assert parent.stdout is not None
        assert parent.stdout.readline()
        (renderer,) = children_of(parent.pid)
        parent.kill()
        parent.wait()
        _, status = os.waitpid(renderer, 0)
    assert os.WTERMSIG(status) == signal.SIGKILL
    assert len(list((tmp_path / "out").glob("*.npz"))) < 500


def test_nothing_missing_starts_no_process(summer, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/nowhere")
    render(make_job("summer-noon"), summer)


def replace_interpreter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    """Replace the interpreter children run by a shell script."""
    path = tmp_path / "python"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(path))


def test_a_dying_child_is_one_clear_line(tmp_path, monkeypatch):
    replace_interpreter(
        tmp_path, monkeypatch, "echo noise >&2; echo MemoryError: no room >&2; exit 3"
    )
    with pytest.raises(RenderError, match=r"^[^\n]*exit code 3: MemoryError: no room$"):
        render(make_job("summer-noon"), tmp_path / "out")


def test_a_killed_child_names_its_signal(tmp_path, monkeypatch):
    replace_interpreter(tmp_path, monkeypatch, "kill -9 $$")
    with pytest.raises(RenderError, match="signal 9"):
        render(make_job("summer-noon"), tmp_path / "out")


def test_a_missing_library_names_the_packages(tmp_path, monkeypatch):
    line = "ImportError: libXi.so.6: cannot open shared object file: No such file or directory"
    replace_interpreter(tmp_path, monkeypatch, f"echo '{line}' >&2; exit 1")
    with pytest.raises(RenderError, match=r"libXi\.so\.6.*apt-get install .*libxi6"):
        render(make_job("summer-noon"), tmp_path / "out")


def test_a_child_that_stops_early_is_an_error(tmp_path, monkeypatch):
    replace_interpreter(tmp_path, monkeypatch, "exit 0")
    with pytest.raises(RenderError, match="3 frames missing"):
        render(make_job("summer-noon"), tmp_path / "out")


def test_bad_jobs_are_refused(tmp_path):
    with pytest.raises(InputError, match="unknown condition"):
        render(make_job("summer-noon").model_copy(update={"condition": "x"}), tmp_path)
    with pytest.raises(InputError, match="unknown preset"):
        render(make_job("summer-noon").model_copy(update={"preset": "x"}), tmp_path)
    values = make_job("summer-noon").model_dump()
    with pytest.raises(ValidationError, match="extra"):
        RenderJob(**values, colour="red")
    with pytest.raises(ValidationError, match="4 x 4"):
        RenderJob(**{**values, "poses": {0: [[1.0]]}})
