"""What covers the ground: floods lie low, thawing snow in the shade, leaves under their trees."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from objconnect.scene.bundle.labels import CLASSES
from simulate.look import ground
from simulate.look.conditions import condition
from simulate.look.cover import NO_COVER, cover
from simulate.place.world import World
from tests.simulate.towns import cached_town


@pytest.fixture
def town() -> World:
    return cached_town(1, 120)


def texels(town: World) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """East and north (n, n), metres, of the middles of the texels."""
    n, side = len(town.ground.labels), town.ground.texel_m
    axis = (np.arange(n) + 0.5 - 0.5 * n) * side
    x, y = np.meshgrid(axis, axis)
    return x, y


def test_most_conditions_cover_nothing(town: World) -> None:
    for name in ("summer-noon", "snow-dusk", "autumn-noon-wet", "winter-morning-fog"):
        assert cover(town, condition(name)) == NO_COVER


def test_floods_lie_on_the_lowest_open_ground(town: World) -> None:
    shown = condition("spring-noon-flood")
    covered = cover(town, shown)
    assert covered.flood is not None
    wet = covered.flood > 0.5
    names = ("grass", "field", "path")
    is_open = np.isin(town.ground.labels, [CLASSES[name] for name in names])
    assert not wet[~is_open].any()
    assert wet[is_open].mean() == pytest.approx(shown.weather.flood, abs=0.08)
    height = town.terrain.height(*texels(town))
    assert height[wet].max() < np.quantile(height[is_open], 0.6)
    mirrored = ground.specular_map(town.ground, shown, 1, covered)
    assert (mirrored[covered.flood == 1] == 255).all()


def test_thaw_leaves_snow_in_the_shade(town: World) -> None:
    """North of buildings, more of it stays than south of them; without cover it lies alike."""
    shown = condition("melt-noon")
    sides: dict[str, list[NDArray[np.bool_]]] = {"north": [], "south": []}
    x, y = texels(town)
    grass = town.ground.labels == CLASSES["grass"]
    for item in town.objects:
        if item.class_name == "building":
            radius = 0.5 * float(np.linalg.norm(item.size[:2]))
            near_item = grass & (np.abs(x - item.centre[0]) < 3)
            away = y - item.centre[1]
            sides["north"].append(near_item & (away > 0.6 * radius) & (away < radius + 3))
            sides["south"].append(near_item & (away < -0.6 * radius) & (away > -radius - 3))
    where = {name: np.any(found, axis=0) for name, found in sides.items()}
    where = {name: part & ~where["south" if name == "north" else "north"]
             for name, part in where.items()}  # fmt: skip
    white = ground.bake(town.ground, shown, 1, cover(town, shown)).min(-1) > 150
    north, south = white[where["north"]].mean(), white[where["south"]].mean()
    assert north > south + 0.2
    assert 0.05 < white[grass].mean() < 0.7


def test_leaves_lie_under_broadleaved_trees(town: World) -> None:
    covered = cover(town, condition("leaffall-noon"))
    assert covered.litter is not None
    x, y = texels(town)
    trees = [item for item in town.objects if item.shape.startswith("broadleaf_")]
    distance = np.min(
        [np.hypot(x - t.centre[0], y - t.centre[1]) / (0.5 * t.size[0]) for t in trees], axis=0
    )
    assert covered.litter[distance < 1].min() > 0.5
    assert covered.litter[distance > 8].max(initial=0) < 0.1


def test_half_of_the_fields_are_ploughed_after_harvest(town: World) -> None:
    """Ploughed earth is darker than stubble, and its colour is that of a whole parcel."""
    labels, tone = town.ground.labels.copy(), town.ground.tone.copy()
    labels[:] = CLASSES["field"]
    tone[:, : len(tone) // 2], tone[:, len(tone) // 2 :] = 100, 101
    fields = ground.Ground(town.ground.texel_m, labels, tone, ())
    baked = ground.bake(fields, condition("harvest-noon"), 1).mean(-1)
    ploughed, stubble = np.array_split(baked, 2, axis=1)
    assert np.quantile(ploughed, 0.95) < np.quantile(stubble, 0.05)
