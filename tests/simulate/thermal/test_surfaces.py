"""Surfaces follow the weather within the limits of physics; every ground has a substance."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from objconnect.scene.bundle.labels import CLASSES, FIRST_OBJECT_LABEL
from simulate.look.conditions import DEFAULT_ORIGIN, LIGHTS, condition
from simulate.look.seasons import SEASONS
from simulate.thermal.planck import band_radiance
from simulate.thermal.sensor import describe_thermal, expose_thermal
from simulate.thermal.shade import Shade
from simulate.thermal.substances import (
    NAMES,
    SUBSTANCES,
    property_array,
    substance_name,
    substance_table,
)
from simulate.thermal.surfaces import Surfaces
from simulate.thermal.weather import HOURS, ZERO_C, ThermalWeather, thermal_weather
from tests.simulate.towns import cached_town

NUMBERS = np.arange(len(NAMES)).astype(np.int16)
CALM = ThermalWeather(
    air_k=np.full(HOURS, 290.0), sun=np.tile([0.0, 0.0, 1.0], (HOURS, 1)), direct_w=np.zeros(HOURS),
    diffuse_w=np.zeros(HOURS), loss_w=0.0, ground_k=290.0, water_k=290.0,
    zenith_transmittance=0.5, cloud=0.0, extinction=0.0,
)  # fmt: skip


def level_c(name: str, *, lit: bool = True) -> dict[str, float]:
    """The temperatures of level surfaces of every substance under a condition, Celsius."""
    under = condition(name)
    weather = thermal_weather(under, DEFAULT_ORIGIN)
    surfaces = Surfaces(weather, under.wet)
    sun = weather.direct_w * np.maximum(weather.sun[:, 2], 0) if lit else 0.0
    sunlight = (surfaces.weights @ (weather.diffuse_w + sun)).astype(np.float32)
    ones = np.ones(len(NAMES), np.float32)
    kelvin = surfaces.temperature(NUMBERS, property_array("albedo"), sunlight, ones)
    return dict(zip(NAMES, (kelvin - ZERO_C).tolist(), strict=True))


def test_without_sun_and_loss_everything_has_the_temperature_of_the_air() -> None:
    surfaces = Surfaces(CALM, wet=0.0)
    zero, ones = np.zeros(len(NAMES), np.float32), np.ones(len(NAMES), np.float32)
    kelvin = surfaces.temperature(NUMBERS, zero, zero, ones)
    outdoors = np.array([SUBSTANCES[n].backing != "indoors" or not SUBSTANCES[n].conductance
                         for n in NAMES])  # fmt: skip
    assert np.abs(kelvin[outdoors] - 290.0).max() < 1e-3
    # Rooms at 20 degrees warm the others by a part of the difference.
    assert ((kelvin[~outdoors] > 290.0) & (kelvin[~outdoors] < 293.15)).all()


def test_the_balance_of_energy_closes() -> None:
    """In steady weather, absorbed sunlight leaves by air, sky, evaporation and what lies behind."""
    weather = CALM.__class__(**{**CALM.__dict__, "loss_w": 80.0})
    surfaces = Surfaces(weather, wet=0.0)
    albedo = property_array("albedo")
    sunlight, ones = np.full(len(NAMES), 700.0, np.float32), np.ones(len(NAMES), np.float32)
    excess = surfaces.temperature(NUMBERS, albedo, sunlight, ones).astype(float) - 290.0
    behind = np.array([3.15 if s.backing == "indoors" else 0.0 for s in SUBSTANCES.values()])
    emissivity, conductance = property_array("emissivity"), property_array("conductance")
    gain = (1 - albedo) * 700.0 * (1 - property_array("evaporation"))
    lost = property_array("transfer") * excess + conductance * (excess - behind)
    lost += emissivity * (80.0 + 4 * 5.670374419e-8 * 290.0**3 * excess)
    assert np.abs(gain - lost).max() < 0.02


def test_noon_heats_roofs_and_night_cools_them_below_water() -> None:
    noon, night = level_c("summer-noon"), level_c("summer-night")
    air_noon, air_night = 23.1, 18.6
    assert noon["tile"] > noon["grass"] + 10 > air_noon + 10
    assert noon["asphalt"] > noon["grass"] + 8
    assert noon["water"] < air_noon
    assert abs(noon["leaf"] - air_noon) < 9
    assert night["tile"] < air_night - 2
    assert night["grass"] < night["asphalt"]
    assert night["water"] > night["tile"] + 2
    assert level_c("summer-noon", lit=False)["tile"] < noon["tile"] - 15
    assert level_c("summer-noon-overcast")["tile"] < noon["tile"] - 10


@pytest.mark.parametrize("name", ["-".join(parts) for parts in product(SEASONS, LIGHTS)])
def test_temperatures_are_those_of_the_outdoors(name: str) -> None:
    found = level_c(name)
    assert -30 < min(found.values()) < max(found.values()) < 75
    record = describe_thermal(condition(name), DEFAULT_ORIGIN)
    assert record.low_c < record.air_c + 1
    assert record.high_c > record.low_c + 2


def test_every_ground_has_a_substance() -> None:
    """Objects of all presets are in ``test_presets``."""
    for name, label in CLASSES.items():
        if 0 < label < FIRST_OBJECT_LABEL:
            assert substance_name("ground", name) in SUBSTANCES
            assert substance_name("plain", name) in SUBSTANCES


def test_an_unknown_surface_is_an_error() -> None:
    with pytest.raises(
        ValueError, match="no substance is known for the material 'cheese' of the class 'car'"
    ):
        substance_name("cheese", "car")
    with pytest.raises(ValueError, match="no substance"):
        substance_name("ground", "car")
    table = substance_table(["cheese", "paint"])
    assert (table[1] == -1).all()
    assert NAMES[table[2, CLASSES["car"]]] == "bodywork"


def test_objects_cast_shade_away_from_the_sun() -> None:
    town = cached_town(5, 120.0)
    house = max((o for o in town.objects if o.class_name == "building"), key=lambda o: o.size[2])
    sun = np.array([[np.cos(0.6), 0.0, np.sin(0.6)], [0.0, 0.0, -1.0]])
    shade = Shade(town, sun)
    reach = 0.5 * float(np.hypot(*house.size[:2]))
    up = np.zeros((1, 3, 3), np.float32)
    up[..., 2] = 1
    points = np.repeat(house.centre[None, None], 3, 1).astype(np.float32)
    points[0, 0, 2] += 0.5 * house.size[2] + 30  # high above
    points[0, 1, 0] -= 0.5 * min(house.size[:2]) + 1.0  # west of it, on the far side of the sun
    points[0, 1, 2] = house.centre[2] - 0.5 * house.size[2] + 0.3
    points[0, 2, 0] += 10 * reach
    points[0, 2, 2] += 60
    found = shade(0, points, up)
    assert found[0, 0] == 0
    assert found[0, 1] == 1
    assert found[0, 2] == 0
    assert (shade(1, points, up) == 1).all(), "at night everything is in the shade"


def test_noise_is_that_of_the_record_and_of_the_seed() -> None:
    record = describe_thermal(condition("summer-noon"), DEFAULT_ORIGIN)
    flat = np.full((200, 200), band_radiance(300.0), np.float32)
    counts = expose_thermal(flat, record, np.random.default_rng(1))
    kelvin = record.kelvin(counts)
    assert abs(kelvin.mean() - 300.0) < 0.005
    assert kelvin.std() == pytest.approx(record.netd_k, rel=0.1)
    again = expose_thermal(flat, record, np.random.default_rng(1))
    assert np.array_equal(counts, again)
    cold = np.full((200, 200), band_radiance(250.0), np.float32)
    assert record.kelvin(expose_thermal(cold, record, np.random.default_rng(1))).std() > 0.06
