"""Lamps at night: every street lamp and all traffic, and where they shine."""

from __future__ import annotations

import numpy as np
import pytest

from simulate.look.lamps import beams
from simulate.look.textures import panes
from simulate.place.change import Change, change_world
from simulate.place.world import Facade
from tests.simulate.towns import cached_town


def test_every_street_lamp_and_all_traffic_shine() -> None:
    town = cached_town(5, 120)
    lamps = [item for item in town.objects if item.class_name == "lamp"]
    driven = [item for item in town.objects if item.driven]
    vehicles = [item for item in town.objects if item.class_name in ("car", "van", "truck")]
    assert lamps
    assert 0 < len(driven) < len(vehicles), "parked vehicles are dark"
    assert all(item in vehicles for item in driven)
    shining = list(beams(town))
    assert len(shining) == len(lamps) + len(driven)
    down = [beam for beam in shining if beam.direction[2] == -1]
    assert len(down) == len(lamps)
    assert len({beam.rgb for beam in down}) == 1
    for lamp, beam in zip(lamps, down, strict=True):
        ground = float(town.terrain.height(*beam.position[:2]))
        assert beam.position[2] - ground == pytest.approx(6.8, abs=0.4)
        assert np.abs(beam.position - lamp.centre).max() < 3.5
    for beam in shining:
        assert np.linalg.norm(beam.direction) == pytest.approx(1)


def test_moved_vehicles_are_in_traffic_where_their_neighbours_are() -> None:
    town = cached_town(5, 120)
    changed = change_world(town, Change(cars_moved=0.5, seed=1)).world
    kept = {item.id: item for item in town.objects}
    assert any(item.driven for item in changed.objects if item.id not in kept)
    assert any(not item.driven for item in changed.objects if item.id not in kept)
    for item in changed.objects:
        if item.id in kept:
            assert item.driven == kept[item.id].driven


@pytest.mark.parametrize("style", [f for f in Facade if f is not Facade.SHED_BOARDS])
def test_windows_let_light_out(style: Facade) -> None:
    lit = panes(style)[..., 0] > 0
    assert 0.03 < lit.mean() < 0.4


def test_sheds_have_no_windows() -> None:
    assert not panes(Facade.SHED_BOARDS)[..., :3].any()
