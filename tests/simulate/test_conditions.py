"""Conditions: their names, light from the true position of the sun, and unchanged geometry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from objconnect.scene.bundle.labels import CLASSES
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic
from simulate.camera.pinhole import PinholeCamera
from simulate.config import SimulateConfig
from simulate.flight.config import ObliqueFlight
from simulate.flight.context import FlightContext
from simulate.flight.flights import plan_oblique
from simulate.look import ground
from simulate.look.conditions import DEFAULT_ORIGIN, LIGHTS, WEATHER, Light, condition
from simulate.look.seasons import SEASONS
from simulate.look.sun import sun_position
from simulate.place.change import Change
from simulate.render.job import RenderJob, frame_path
from simulate.render.pool import render
from tests.simulate.test_flights import pinhole
from tests.simulate.towns import cached_town


def test_every_combination_is_a_condition() -> None:
    names = [f"{s}-{t}-{w}" for s in SEASONS for t in LIGHTS for w in WEATHER]
    all_of_them = [condition(name) for name in names]
    assert len(
        {(c.time, c.luminary.watts, c.weather.visibility_m, c.weather.wet) for c in all_of_them}
    ) == len(names)
    for c in all_of_them:
        assert sun_position(c.time, DEFAULT_ORIGIN) == (c.sun.azimuth, c.sun.elevation)
        assert c.sun.elevation > 5 or (c.night is not None and c.sun.elevation < -11.8)
        assert set(c.season.ground) == set(condition("summer-noon").season.ground)


def test_clear_goes_without_saying() -> None:
    assert condition("summer-noon-clear") == condition("summer-noon")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("monsoon-noon", "no season 'monsoon', choose one of spring, summer, .*leafoff.*snow"),
        ("summer-midnight", "no light 'midnight', choose one of morning, noon, afternoon, dusk"),
        ("summer-noon-hail", "no weather 'hail', choose one of clear, overcast, fog, wet"),
        ("summer", "write SEASON-LIGHT.*seasons: spring, .*lights: morning, .*weather: clear, "),
        ("summer-noon-fog-wet", r"write SEASON-LIGHT\[-WEATHER\]"),
    ],
)
def test_unknown_parts_name_the_valid_ones(name: str, message: str) -> None:
    with pytest.raises(InputError, match=f"^unknown condition '{name}': {message}") as caught:
        condition(name)
    assert "\n" not in str(caught.value)


def test_the_two_first_conditions_keep_their_hours() -> None:
    noon, dusk = condition("summer-noon"), condition("winter-dusk")
    assert f"{noon.time:%Y-%m-%d %H}" == "2025-07-02 11"
    assert 160 < noon.sun.azimuth < 180
    assert noon.sun.elevation > 60
    assert f"{dusk.time:%Y-%m-%d %H}" == "2026-01-20 14"
    assert 220 < dusk.sun.azimuth < 232
    assert dusk.sun.elevation == pytest.approx(10, abs=0.2)
    assert dusk.sun.rgb[2] < noon.sun.rgb[2] - 0.2  # redder


def test_light_follows_the_place() -> None:
    east, west = (condition("summer-morning", Geodetic(47.0, e, 0.0)) for e in (100.0, -100.0))
    assert (west.time - east.time).total_seconds() / 3600 == pytest.approx(200 / 15, abs=0.1)
    assert west.sun.elevation == pytest.approx(east.sun.elevation, abs=0.3)
    south = condition("summer-noon", Geodetic(-35.0, 18.0, 0.0))
    assert south.time.month == 12
    assert abs((south.sun.azimuth + 180) % 360 - 180) < 60


def test_a_polar_night_is_refused() -> None:
    with pytest.raises(InputError, match="'winter-noon' has no daylight at latitude 78 on 2026"):
        condition("winter-noon", Geodetic(78.0, 15.0, 0.0))
    with pytest.raises(InputError, match="no daylight at latitude 78"):
        SimulateConfig.load(None, {"origin": (78.0, 15.0, 0.0)})


@pytest.mark.parametrize("latitude", [-90.0, -66.0, -35.0, 0.0, 47.0, 60.0, 78.0, 90.0])
def test_every_latitude_has_nights(latitude: float) -> None:
    """In white nights, on the nearest day with a night; in polar nights, lower than asked for."""
    origin = Geodetic(latitude, 15.0, 0.0)
    for season in ("summer", "winter"):
        night = condition(f"{season}-night", origin)
        assert night.sun.elevation < -11.8
        assert night.sun.watts == 0
        assert night.night is not None
        assert sun_position(night.time, origin)[1] == night.sun.elevation
    if abs(latitude) < 50:
        assert condition("summer-night", origin).time.month == (7 if latitude >= 0 else 12)


def test_a_light_that_never_comes_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LIGHTS.built_in, "deepnight", Light(-50.0))
    with pytest.raises(InputError, match="never sinks to -50 degrees at latitude 78: choose"):
        condition("winter-deepnight", Geodetic(78.0, 15.0, 0.0))


def test_nights_are_dark_and_more_windows_are_lit_in_the_evening() -> None:
    summer, winter = (condition(f"{season}-night") for season in ("summer", "winter"))
    assert summer.night is not None
    assert winter.night is not None
    assert summer.time.hour - winter.time.hour >= 3
    assert 0.5 > winter.night.windows > summer.night.windows > 0.2
    assert summer.luminary is summer.night.moon
    # 12 stops: from 1/1600 s at ISO 100 to 1/30 s at ISO 7000.
    assert 10 < winter.dimness < summer.dimness < 14
    assert condition("summer-noon").dimness == 0
    assert 1 < condition("autumn-noon-overcast").dimness < 3
    assert condition("summer-night-overcast").night.moon.watts < 0.1 * summer.night.moon.watts


def test_rain_darkens_everything_and_lies_on_sealed_ground() -> None:
    town = cached_town(1, 120)
    dry, wet = condition("autumn-noon"), condition("autumn-noon-wet")
    darker = ground.bake(town.ground, wet, 1).mean() / ground.bake(town.ground, dry, 1).mean()
    assert 0.6 < darker < 0.85  # of sRGB bytes
    assert not ground.specular_map(town.ground, dry, 1).any()
    water = ground.specular_map(town.ground, wet, 1)
    road = town.ground.labels == CLASSES["road"]
    assert water[road].min() > 0
    assert (water[road] == 255).mean() > 0.03  # puddles
    assert water[town.ground.labels == CLASSES["grass"]].max() == 0


# --- rendered ------------------------------------------------------------------------------------

SEED, AREA = 5, 120.0
CAMERA = PinholeCamera(width=96, height=72, f=80.0, cx=48.0, cy=36.0)


def render_frame(name: str, folder: Path, bare: bool = False) -> dict[str, np.ndarray]:
    height = cached_town(SEED, AREA).terrain.height
    context = FlightContext(AREA, height, pinhole(96, 72, 80.0))
    flight = ObliqueFlight(radius_m=50.0, altitude_m=45.0)
    pose = plan_oblique(flight, context, 1, np.random.default_rng(0))[0]
    job = RenderJob(
        seed=SEED, side_m=AREA, condition=name, change=Change(bare_trees=bare),
        camera=CAMERA, samples=1, poses={0: pose.tolist()},
    )  # fmt: skip
    render(job, folder)
    with np.load(frame_path(folder, 0)) as arrays:
        return dict(arrays)


def has_same_geometry(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> bool:
    return all(np.array_equal(a[layer], b[layer]) for layer in a.keys() - {"rgb"})


@pytest.mark.thorough
def test_season_light_and_weather_move_nothing(tmp_path: Path) -> None:
    """Every season, every light and every weather once, bit for bit."""
    seasons = [name for name, season in SEASONS.items() if not season.bare]
    size = max(len(seasons), len(LIGHTS), len(WEATHER))
    names = ["-".join(list(part)[k % len(part)] for part in (seasons, LIGHTS, WEATHER))
             for k in range(size)]  # fmt: skip
    shots = {name: render_frame(name, tmp_path / name) for name in names}
    first = shots[names[0]]
    for name in names[1:]:
        assert has_same_geometry(first, shots[name]), name
        assert np.abs(first["rgb"].astype(int) - shots[name]["rgb"]).mean() > 8, name
    # Fog takes contrast, more of it farther away.
    fog = next(shot for name, shot in shots.items() if name.endswith("fog"))
    near = (first["depth"] > 0) & (first["depth"] < 60)
    far = first["depth"] > 90
    contrast = [np.abs(np.diff(c["rgb"].astype(float), axis=0, append=0)) for c in (first, fog)]
    kept = [contrast[1][part].mean() / contrast[0][part].mean() for part in (near, far)]
    assert kept[1] < 0.8 * kept[0] < 0.8


@pytest.mark.slow
def test_no_season_light_and_weather_together_move_anything(tmp_path: Path) -> None:
    """Conditions that hold every pair of parts: those that declare nothing show one geometry, those
    that declare bare trees another."""
    shown: dict[bool, dict[str, np.ndarray]] = {}
    weather = list(WEATHER)
    for k, season in enumerate(SEASONS):
        for i, light in enumerate(LIGHTS):
            name = f"{season}-{light}-{weather[(k + i) % len(weather)]}"
            bare = condition(name).season.bare
            shot = render_frame(name, tmp_path / name, bare)
            assert has_same_geometry(shown.setdefault(bare, shot), shot), name
    assert not has_same_geometry(shown[False], shown[True])
