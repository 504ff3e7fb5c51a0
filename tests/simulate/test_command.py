"""The command ``simulate``: complete scenes, equal after an interruption, and no partial files."""

from __future__ import annotations

import hashlib
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from objconnect.scene.bundle.frames import LAYERS, Frames
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import geodetic_from_enu
from objconnect.scene.storage.exif import read_exif
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.locks import write_lock
from simulate.command import _frames, draw_drift, find_finished, simulate
from simulate.config import SimulateConfig
from simulate.render.disk import estimate_bytes
from simulate.render.libraries import PACKAGES, require_libraries
from tests.conftest import RENDERED


def test_scene_is_whole(rendered: Scene) -> None:
    assert rendered.find_changed_files() == []
    assert rendered.manifest.seed == RENDERED.seed
    assert set(rendered.splits.queries) == {
        "summer-noon-nadir-query",
        "winter-dusk-oblique-query",
    }
    assert (rendered.path / "pictures" / "contact-sheet.png").stat().st_size > 10_000
    assert not list(rendered.path.rglob(".*")), "nothing of the rendering is left behind"


def test_annotations_fit_the_objects(rendered: Scene) -> None:
    known = {item.id for item in rendered.objects.objects}
    classes = rendered.objects.classes
    for session in rendered.sessions:
        frames = rendered.frames(session)
        with rendered.layers(session) as dense:
            for k in range(len(frames)):
                instance, semantic = dense.read("instance", k), dense.read("semantic", k)
                assert set(np.unique(instance)) - {0} <= known
                assert set(np.unique(semantic)) <= set(classes.values())
                # An object's pixels carry its class.
                for item in rendered.objects.objects:
                    labels = np.unique(semantic[instance == item.id])
                    assert set(labels) <= {classes[item.class_name]}
                normal = dense.read("normal", k).astype(float) / 127
                surface = dense.read("depth", k) > 0
                assert np.abs(np.linalg.norm(normal[surface], axis=-1) - 1).max() < 0.02


def test_photographs_carry_what_a_drone_writes(rendered: Scene) -> None:
    frames = rendered.frames("winter-dusk-oblique-query")
    for k, name in enumerate(frames.names):
        exif = read_exif(rendered.images_root / name)
        expected = geodetic_from_enu(frames.gps_prior[k], rendered.manifest.origin)
        assert exif.position is not None
        assert np.allclose(exif.position, expected, atol=[1e-7, 1e-7, 1e-3])
        assert exif.time is not None
        assert exif.time.timestamp() == pytest.approx(frames.time[k], abs=1)
        camera = frames.cameras[k]
        assert exif.focal_35mm == pytest.approx(36 * camera.focal[0] / camera.width, rel=1e-4)
        assert read_rgb(rendered.images_root / name, frames.cameras[k]).std() > 10


def test_pixels_are_recorded_apart_from_their_compression(rendered: Scene) -> None:
    pixels = rendered.manifest.pixels_sha256
    assert list(pixels) == list(rendered.covisibility.names)
    session = "winter-dusk-oblique-query"
    frames = rendered.frames(session)
    digest = pixels[frames.names[1]]
    assert set(digest) == {"image", *LAYERS}
    rgb = read_rgb(rendered.images_root / frames.names[1], frames.cameras[1])
    assert digest["image"] == hashlib.sha256(rgb.tobytes()).hexdigest()
    with rendered.layers(session) as dense:
        depth = dense.read("depth", 1)
    assert digest["depth"] == hashlib.sha256(depth.tobytes()).hexdigest()


def test_map_and_query_flights_differ(rendered: Scene) -> None:
    mapped = rendered.frames("summer-noon-nadir-map").poses.centre().numpy()
    queries = rendered.frames("summer-noon-nadir-query").poses.centre().numpy()
    nearest = np.linalg.norm(queries[:, None] - mapped[None], axis=-1).min(1)
    assert nearest.min() > 1.0
    assert abs(queries[:, 2].mean() - mapped[:, 2].mean()) > 5


# The command line, killed with all its processes as soon as the third frame is there.
KILLS_ITSELF = """
import os, signal
from benchmark import cli
from simulate import command

render = command.render

def render_three(job, folder, jobs, on_frame):
    def count(frame):
        on_frame(frame)
        if frame == 2:
            os.killpg(0, signal.SIGKILL)
    render(job, folder, jobs, count)

command.render = render_three
cli.main()
"""


def start_simulate(
    out: Path, config: Path, *words: str, program: Sequence[str] = ("-m", "benchmark.cli")
) -> subprocess.Popen[bytes]:
    """The command line at work on RENDERED, in a process group of its own."""
    config.write_text(RENDERED.model_dump_json())  # JSON is YAML
    command = [sys.executable, *program, "simulate", "--config", str(config)]
    return subprocess.Popen([*command, "--out", str(out), *words], start_new_session=True)


def digests_without_map(scene: Scene) -> dict[str, str]:
    return {k: v for k, v in scene.manifest.sha256.items() if not k.startswith("map/")}


@pytest.mark.thorough
def test_killed_and_resumed_is_the_same_scene(rendered: Scene, tmp_path: Path) -> None:
    """kill -9 in the middle loses no finished frame, and the scene ends bit for bit the same."""
    out = tmp_path / "hamlet"
    killed = start_simulate(out, tmp_path / "config.yaml", program=("-c", KILLS_ITSELF))
    assert killed.wait() == -signal.SIGKILL
    assert not (out / "scene.json").exists()
    finished = {p: p.stat().st_mtime_ns for p in out.rglob("*.npz") if p.name < "000002.npz"}
    assert finished
    with pytest.raises(InputError, match="not a finished scene"):
        Scene.open(out)
    resumed = simulate(RENDERED, out)
    assert resumed.manifest.sha256 == digests_without_map(rendered)


@pytest.mark.slow
def test_killed_at_ten_random_moments_is_the_same_scene(rendered: Scene, tmp_path: Path) -> None:
    """Ten times kill -9 and the same command again; every other time the parent alone is killed."""
    rng = np.random.default_rng(0)
    kills, finished = 0, 0
    out = tmp_path / "hamlet"
    while kills < 10:
        child = start_simulate(out, tmp_path / "config.yaml", "--jobs", "2")
        try:
            assert child.wait(timeout=rng.uniform(1.0, 14.0)) == 0
        except subprocess.TimeoutExpired:
            (os.kill if kills % 2 else os.killpg)(child.pid, signal.SIGKILL)
            child.wait()
            kills += 1
            continue
        # Done before it could be killed: compare, and begin anew.
        assert Scene.open(out).manifest.sha256 == digests_without_map(rendered)
        shutil.rmtree(out)
        finished += 1
    resumed = simulate(RENDERED, out)
    assert resumed.manifest.sha256 == digests_without_map(rendered)
    assert resumed.manifest.pixels_sha256 == rendered.manifest.pixels_sha256
    assert resumed.find_changed_files() == []
    assert not list(out.rglob(".*"))
    print(f"{kills} kills, finished {finished} times between them")


def test_what_killed_runs_leave_is_swept_up(rendered_copy: Path, tmp_path: Path) -> None:
    """Wherever a run was killed, the same command finishes the scene and leaves nothing behind."""
    (rendered_copy / ".objconnect-config.json").write_text(RENDERED.model_dump_json())
    simulate(RENDERED, rendered_copy)  # killed after the manifest
    assert not (rendered_copy / ".objconnect-config.json").exists()
    (rendered_copy / "scene.json").unlink()
    (rendered_copy / ".objconnect-config.json").write_text(RENDERED.model_dump_json())
    session = rendered_copy / "sessions" / "summer-noon-nadir-map"
    (session / ".objconnect-abcd1234.partial").write_bytes(b"half")
    (session / ".objconnect-rendered").mkdir()
    (session / ".objconnect-rendered" / "000000.npz").write_bytes(b"whole")
    assert simulate(RENDERED, rendered_copy).find_changed_files() == []
    assert not list(rendered_copy.rglob(".*"))
    # Killed while it claimed the folder.
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / ".objconnect-efgh5678.partial").write_bytes(b"")
    with pytest.raises(InputError, match="not a finished scene"):
        Scene.open(tmp_path / "new")
    assert find_finished(tmp_path / "new", RENDERED) is None, "it may be claimed"


def test_finished_scene_is_left_alone(rendered_copy: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in rendered_copy.rglob("*")}
    simulate(RENDERED, rendered_copy)
    assert before == {path: path.stat().st_mtime_ns for path in rendered_copy.rglob("*")}


def test_scenes_from_before_there_was_a_choice_of_denoiser_stay_what_they_were(
    rendered: Scene,
) -> None:
    """Their configuration does not name one; it was the one that is now called high."""
    assert "denoising" not in rendered.manifest.config
    assert find_finished(rendered.path, RENDERED) is not None
    with pytest.raises(InputError, match="another configuration"):
        find_finished(rendered.path, RENDERED.model_copy(update={"denoising": "fast"}))


def test_another_configuration_is_refused(rendered_copy: Path) -> None:
    with pytest.raises(InputError, match="another configuration"):
        simulate(RENDERED.model_copy(update={"seed": 12}), rendered_copy)


def test_two_runs_do_not_write_one_scene(tmp_path: Path) -> None:
    out = tmp_path / "scene"
    with write_lock(out), pytest.raises(InputError, match="another run is writing"):
        simulate(RENDERED, out)
    assert not out.exists()


def test_a_folder_of_other_things_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(InputError, match="not empty and not a scene"):
        simulate(RENDERED, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_full_disk_is_said_before_anything_is_rendered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=5_000_000))
    with pytest.raises(InputError, match=r"needs up to \d+ MB more .* has 5 MB free: ") as caught:
        simulate(RENDERED, tmp_path / "deep" / "scene")
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_the_estimate_holds_what_a_scene_takes(rendered: Scene) -> None:
    sessions = {name: (n, n) for name, n in zip("abc", (12, 4, 3), strict=True)}
    packed = sum(file.stat().st_size for file in rendered.images_root.rglob("*") if file.is_file())
    needed = estimate_bytes(sessions, RENDERED.size**2)
    assert packed + 13 * 12 * RENDERED.size**2 < needed < 3 * packed + 13 * 12 * RENDERED.size**2
    assert estimate_bytes({}, 512**2) == 0


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"preset": "atlantis"}, "atlantis"),
        ({"sessions": ["monsoon:nadir"]}, "monsoon"),
        ({"sessions": ["summer-noon"]}, "condition:flight"),
        ({"sessions": ["summer-noon:nadir:query"]}, "role map"),
        ({"sessions": []}, "at least 1 item"),
        ({"altitude": 90}, "unknown key 'altitude'"),
        ({"area": -5}, "area"),
        ({"frames": 0}, "frames"),
        ({"origin": [91, 0, 0]}, "'origin'.*not on earth"),
        ({"origin": [47, 200, 0]}, "'origin'.*not on earth"),
        ({"gps_sigma_m": [-1, 1, 1]}, "'gps_sigma_m.0'"),
        ({"map_plan": {"altitude_m": -10}}, "unknown key 'map_plan.altitude_m'"),
    ],
)
def test_bad_configuration_is_one_line(overrides: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        SimulateConfig.load(None, overrides)
    assert "\n" not in str(caught.value)


def test_sessions_from_words() -> None:
    words = ["summer-noon:nadir", "winter-dusk:oblique", "summer-noon:oblique:map"]
    config = SimulateConfig.load(None, {"sessions": words})
    assert [s.role for s in config.sessions] == ["map", "query", "map"]
    assert config.session_names()[1] == "winter-dusk-oblique-query"
    twice = SimulateConfig.load(None, {"sessions": ["summer-noon:nadir"] * 3})
    assert len(set(twice.session_names())) == 3


def test_named_sessions() -> None:
    def configure_names(*names: str | None) -> SimulateConfig:
        flown = {"condition": "summer-noon", "flight": "nadir", "role": "map"}
        return SimulateConfig.model_validate({"sessions": [flown | {"name": n} for n in names]})

    assert configure_names("map", None).session_names() == ("map", "summer-noon-nadir-map")
    for wrong in (("a", "a", "a-2"), ("../a",), ("A",), ("",), ("a/b",)):
        with pytest.raises(ValueError, match="name"):
            configure_names(*wrong)


def test_the_track_changes_one_thing_at_a_time() -> None:
    track = SimulateConfig.load(Path("uav-sim"), {})
    sessions = dict(zip(track.session_names(), track.sessions, strict=True))
    base = sessions["same"]
    changed = {name: s for name, s in sessions.items() if s.role == "query" and s != base}
    differs = {
        name: {f for f in ("condition", "flight") if getattr(s, f) != getattr(base, f)}
        for name, s in changed.items()
        if name != "same"
    }
    assert differs == {
        "season": {"condition"},
        "time": {"condition"},
        "season-and-time": {"condition"},
        "altitude": {"flight"},
        "oblique": {"flight"},
    }
    assert sessions["map"].condition == base.condition


def test_missing_libraries_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PACKAGES, "libnowhere.so.9", "libnowhere9")
    with pytest.raises(InputError, match="sudo apt-get install -y libnowhere9"):
        require_libraries()


def test_drift_has_its_variance_and_memory() -> None:
    """Of unit variance from its first to its last row, and correlated as asked."""
    rng = np.random.default_rng(0)
    noise = np.stack([draw_drift(40, 0.9, rng) for _ in range(4000)])
    assert np.abs(noise.std(0) - 1).max() < 0.06
    assert (noise[:, 10] * noise[:, 11]).mean() == pytest.approx(0.9, abs=0.03)
    assert (noise[:, 10] * noise[:, 20]).mean() == pytest.approx(0.9**10, abs=0.04)


def test_priors_state_all_their_noise() -> None:
    """White noise alone is drawn as without drift; with it, the error of a flight lasts."""
    poses = np.tile(np.eye(4), (400, 1, 1))
    base = {"gps_sigma_m": [1, 1, 2], "attitude_sigma_deg": 0.5}
    drift = {"gps_drift_m": [3, 3, 4], "attitude_drift_deg": 1.2, "drift_s": 1e6}

    def frames(values: dict[str, object]) -> Frames:
        config = SimulateConfig.load(None, values)
        rng = np.random.default_rng(4)
        return _frames("x", poses, config.photo_camera(), config.sessions[0], config, rng)

    white, lasting = frames(base), frames({**base, **drift})
    assert white.gps_sigma[0].tolist() == [1, 1, 2]
    assert lasting.gps_sigma[0] == pytest.approx([10**0.5, 10**0.5, 20**0.5])
    assert lasting.attitude_sigma_deg[0] == pytest.approx(1.3)
    moved = lasting.gps_prior - white.gps_prior
    assert np.abs(moved.mean(0)).max() > 1
    assert (moved.std(0) < 0.3).all()
    turned = np.abs((white.attitude_prior * lasting.attitude_prior).sum(-1)).min()
    assert turned < np.cos(np.radians(0.1))
