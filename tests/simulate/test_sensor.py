"""Effects of lens and sensor: each acts as configured, repeats with its seed, and spares layers."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from objconnect.scene.bundle.frames import LAYERS
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.storage.images import read_rgb
from simulate.camera.sensor import SensorConfig, expose
from simulate.command import simulate
from simulate.config import SimulateConfig
from simulate.render.job import RenderJob
from simulate.render.pool import render

OnFrame = Callable[[int], None]

GREY = np.full((80, 120, 3), 120, np.uint8)


def expose_picture(picture: np.ndarray = GREY, seed: int = 0, **effects: float) -> np.ndarray:
    return expose(picture, SensorConfig(**effects), np.random.default_rng(seed))


def test_nothing_is_done_by_default_and_all_is_repeatable() -> None:
    assert np.array_equal(expose_picture(), GREY)
    # Linear light and back loses nothing.
    ramp = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, -1)
    assert np.array_equal(expose_picture(ramp, motion_blur_px=1e-3), ramp)
    everything = {
        "exposure_ev": 0.3, "white_balance": 0.05, "vignetting": 0.3, "motion_blur_px": 2,
        "full_well_e": 5000, "read_noise_e": 5,
    }  # fmt: skip
    assert np.array_equal(expose_picture(**everything), expose_picture(**everything))
    assert not np.array_equal(expose_picture(**everything), expose_picture(seed=1, **everything))


def test_exposure_is_in_stops_of_light() -> None:
    stops = np.random.default_rng(0).standard_normal(3)[0]
    bright = expose_picture(exposure_ev=0.5).astype(float)[0, 0, 0] / 255
    linear = ((np.array([120 / 255, bright]) + 0.055) / 1.055) ** 2.4
    assert np.log2(linear[1] / linear[0]) == pytest.approx(0.5 * stops, abs=0.02)


def test_dim_light_lengthens_the_exposure_and_then_raises_the_gain() -> None:
    by_day = SensorConfig(motion_blur_px=0.1, full_well_e=10000, follows_light=True)
    assert by_day.adapt(0) == by_day
    dusk, night, darkest = (by_day.adapt(stops) for stops in (2, 8, 20))
    assert (dusk.motion_blur_px, dusk.full_well_e) == (pytest.approx(0.4), 10000)
    assert (night.motion_blur_px, night.full_well_e) == (
        pytest.approx(5),
        pytest.approx(1953, 1e-3),
    )
    assert (darkest.motion_blur_px, darkest.full_well_e) == (pytest.approx(5), 10000 / 32)
    fixed = SensorConfig(motion_blur_px=0.1, full_well_e=10000)
    assert fixed.adapt(8) == fixed
    assert np.array_equal(
        expose(GREY, SensorConfig(follows_light=True).adapt(9), np.random.default_rng(0)), GREY
    )


def test_records_of_older_scenes_lack_what_follows_the_light() -> None:
    assert "follows_light" not in SensorConfig(full_well_e=500).model_dump()
    following = SensorConfig(follows_light=True)
    assert SensorConfig.model_validate(following.model_dump(mode="json")) == following


def test_white_balance_leaves_green() -> None:
    picture = expose_picture(white_balance=0.2)
    assert (picture[..., 1] == 120).all()
    assert (picture[..., 0] != 120).all()


def test_vignetting_darkens_corners_alike() -> None:
    picture = expose_picture(vignetting=0.4).astype(int)
    assert picture[40, 60, 0] == 120
    assert np.array_equal(picture, picture[::-1, ::-1])
    linear = ((picture[0, 0, 0] / 255 + 0.055) / 1.055) ** 2.4
    full = ((120 / 255 + 0.055) / 1.055) ** 2.4
    assert linear / full == pytest.approx(0.6, abs=0.02)


def test_noise_is_that_of_the_electrons() -> None:
    white = np.full((200, 200, 3), 188, np.uint8)  # half the light of white
    noisy = expose_picture(white, full_well_e=1000, read_noise_e=10).astype(float) / 255
    linear = ((noisy + 0.055) / 1.055) ** 2.4
    assert linear.mean() == pytest.approx(0.503, abs=0.003)
    assert linear.std() == pytest.approx(np.sqrt(503 + 100) / 1000, rel=0.05)


def test_motion_blur_spreads_a_point_where_it_is() -> None:
    point = np.zeros((61, 61, 3), np.uint8)
    point[30, 30] = 255
    streak = expose_picture(point, seed=3, motion_blur_px=9).astype(float)[..., 0] / 255
    light = np.where(streak <= 0.04045, streak / 12.92, ((streak + 0.055) / 1.055) ** 2.4)
    assert light.sum() == pytest.approx(1, abs=0.05)
    v, u = np.mgrid[:61, :61]
    assert (light * u).sum() / light.sum() == pytest.approx(30, abs=0.1)
    assert (light * v).sum() / light.sum() == pytest.approx(30, abs=0.1)
    assert (light > 0.01).sum() >= 5


def test_a_scene_keeps_its_truth_under_every_effect(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not square, through a lens: only the photographs differ. Both are rendered by one job."""
    jobs: list[RenderJob] = []

    def render_once(job: RenderJob, out: Path, processes: int, on_frame: OnFrame) -> None:
        jobs.append(job)
        if len(jobs) == 1:
            render(job, tmp_path / "rendered", processes, on_frame)
        shutil.copytree(tmp_path / "rendered", out, dirs_exist_ok=True)

    monkeypatch.setattr("simulate.command.render", render_once)
    common = {
        "seed": 11, "area": 120, "spp": 1, "size": 96, "camera": {"preset": "mini-2-wide"},
        "sessions": ["summer-noon:nadir:map"], "frames": 2,
    }  # fmt: skip
    effects = {"exposure_ev": 0.3, "vignetting": 0.3, "motion_blur_px": 2, "full_well_e": 5000}
    plain = simulate(SimulateConfig.load(None, common), tmp_path / "plain")
    worn = simulate(SimulateConfig.load(None, {**common, "sensor": effects}), tmp_path / "worn")

    assert jobs[0] == jobs[1]

    def contents(scene: Scene) -> tuple[np.ndarray, list[np.ndarray]]:
        frames = scene.frames("summer-noon-nadir-map")
        with scene.layers("summer-noon-nadir-map") as dense:
            truth = [dense.read(layer, k) for layer in LAYERS for k in range(2)]
        photographs = [read_rgb(scene.images_root / n, frames.cameras[0]) for n in frames.names]
        return np.stack(photographs), [frames.cam_from_world, frames.gps_prior, *truth]

    a, b = contents(plain), contents(worn)
    assert a[0].shape == (2, 54, 96, 3)
    assert np.abs(a[0].astype(int) - b[0]).mean() > 3
    assert all(np.array_equal(x, y) for x, y in zip(a[1], b[1], strict=True))


def test_effects_out_of_range_are_one_line() -> None:
    with pytest.raises(InputError, match="sensor.vignetting"):
        SimulateConfig.load(None, {"sensor": {"vignetting": 1.5}})
    with pytest.raises(InputError, match="needs full_well_e"):
        SimulateConfig.load(None, {"sensor": {"read_noise_e": 5}})
