"""Real models and real GPS, with the model's frame taken away and GPS made worse."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from objconnect.ingestion.georegister import Georegistration, georegister
from objconnect.scene.errors import InputError
from objconnect.scene.flights.textfiles import read_gps
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.sparse_map import MapImage, SparseMap

Array = NDArray[np.float64]
Fixes = dict[str, Array]

SCALE = 0.013
TURN = Pose.exp(torch.tensor([0.4, -1.1, 2.0, 3.0, -5.0, 7.0], dtype=torch.float64))


def lose(model: SparseMap) -> SparseMap:
    """The same model in another frame and scale, as structure from motion would find it."""

    def move(points: Array) -> Array:
        return np.asarray(TURN.transform(torch.from_numpy(SCALE * points)))

    images = {}
    for name, image in model.images.items():
        pose = np.eye(4)
        pose[:3, :3] = image.cam_from_world[:3, :3] @ TURN.rotation.numpy().T
        pose[:3, 3] = -pose[:3, :3] @ move(image.centre[None])[0]
        images[name] = replace(image, cam_from_world=pose)
    return replace(model, images=images, xyz=move(model.xyz))


def flight(path: Path) -> tuple[SparseMap, Fixes]:
    model = read_model(path / "sparse" / "map")
    fixes = read_gps(path / "gps.csv")
    return model, {name: fixes[name] for name in model.names}


@pytest.fixture(scope="module")
def shore(beach: Path) -> tuple[SparseMap, Fixes]:
    return flight(beach)


def off(model: SparseMap, fixes: Fixes, placed: Georegistration) -> Array:
    """Camera minus fix, (N, 3), in the order of the names."""
    return np.asarray(
        placed.apply(lose(model).centres) - np.array([fixes[name] for name in model.names])
    )


def rms(values: Array) -> float:
    return float(np.sqrt((values**2).sum(-1).mean()))


def test_good_gps_is_fitted(shore: tuple[SparseMap, Fixes]) -> None:
    model, fixes = shore
    placed = georegister(lose(model), fixes)
    assert placed.level == "gps"
    assert placed.blunders == ()
    residuals = off(model, fixes, placed)
    # No worse than the flight's own georegistration of the same photographs.
    given = model.centres - np.array([fixes[name] for name in model.names])
    assert rms(residuals[:, :2]) <= rms(given[:, :2])
    assert rms(residuals[:, 2:]) <= rms(given[:, 2:])
    assert np.allclose(placed.sigma, np.sqrt((residuals**2).mean(0)))


def test_blunders_are_named_and_do_not_count(shore: tuple[SparseMap, Fixes]) -> None:
    """Five of thirteen: off by metres, off by a town, on the equator, twice upwards."""
    model, fixes = shore
    good = georegister(lose(model), fixes)
    wrong = dict(fixes)
    moves = [(15, 0, 0), (0, -2000, 300), (5e6, 5e6, -4e6), (0, 0, 60), (0, 0, 60)]
    names = model.names[1:11:2]
    for name, move in zip(names, moves, strict=True):
        wrong[name] = fixes[name] + move
    placed = georegister(lose(model), wrong)
    assert set(placed.blunders) == set(names)
    apart = placed.apply(lose(model).centres) - good.apply(lose(model).centres)
    assert rms(apart) < 0.5


def test_altitudes_that_drift_do_not_tilt_the_world(shore: tuple[SparseMap, Fixes]) -> None:
    model, fixes = shore
    drift = {
        name: fix + np.array([0, 0, 2.0 * fix[0] + 0.5 * fix[1]]) for name, fix in fixes.items()
    }
    placed = georegister(lose(model), drift)
    assert placed.level == "ground"
    assert rms(off(model, fixes, placed)[:, :2]) < 0.65
    ground = placed.apply(lose(model).xyz)
    tilt = np.linalg.lstsq(
        np.column_stack([ground[:, :2], np.ones(len(ground))]), ground[:, 2], rcond=None
    )[0]
    assert np.degrees(np.arctan(np.linalg.norm(tilt[:2]))) < 3


def test_a_hillside_stays_a_hillside(shore: tuple[SparseMap, Fixes]) -> None:
    """Ground and flight inclined by 20 degrees under cameras that look down plumb."""
    model, fixes = shore
    slope = np.array([[1, 0, 0], [0, 1, 0], [0, np.tan(np.radians(20)), 1]])
    images = {}
    for name, image in model.images.items():
        pose = image.cam_from_world.copy()
        pose[:3, 3] = -pose[:3, :3] @ slope @ image.centre
        images[name] = replace(image, cam_from_world=pose)
    hillside = replace(model, images=images, xyz=model.xyz @ slope.T)
    inclined = {name: slope @ fix for name, fix in fixes.items()}
    placed = georegister(lose(hillside), inclined)
    assert placed.level == "gps"
    assert rms(off(hillside, inclined, placed)) < 0.65


def test_gps_that_lags_and_drifts(flights: Path) -> None:
    """The other real flight: altitudes drift by 110 m, positions lag by 16.5 m rms (README)."""
    model, fixes = flight(flights / "caliterra")
    placed = georegister(lose(model), fixes)
    assert placed.level == "ground"
    assert rms(off(model, fixes, placed)[:, :2]) <= 16.5
    moved = placed.apply(lose(model).centres)
    distance = np.linalg.norm(moved - moved.mean(0), axis=1)
    expected = np.linalg.norm(model.centres - model.centres.mean(0), axis=1)
    assert np.median(distance / expected) == pytest.approx(1, abs=0.05)


def test_one_flight_line_takes_up_from_the_ground(shore: tuple[SparseMap, Fixes]) -> None:
    model, fixes = shore
    names = [f"DJI_{k:04d}.jpg" for k in (18, 20, 21, 22)]
    line = replace(model, images={name: model.images[name] for name in names})
    placed = georegister(lose(line), fixes)
    assert placed.level == "ground"
    assert rms(placed.apply(lose(line).xyz) - line.xyz) < 5


def test_too_few_positions(shore: tuple[SparseMap, Fixes]) -> None:
    model, fixes = shore
    with pytest.raises(InputError, match="only 2 of the 13 registered photographs"):
        georegister(model, dict(list(fixes.items())[:2]))
    with pytest.raises(InputError, match="all GPS positions are equal"):
        georegister(model, dict.fromkeys(fixes, np.zeros(3)))


def made_flight(altitudes: int) -> tuple[SparseMap, Fixes, Fixes]:
    """A made flight of 12 cameras in two lines over rough ground, its fixes and the truth.

    Only the first photographs have an altitude.
    """
    rng = np.random.default_rng(1)
    down = np.diag([1.0, -1.0, -1.0])
    truth, images = {}, {}
    camera = Camera("SIMPLE_PINHOLE", 640, 480, (500.0, 320.0, 240.0))
    for k in range(12):
        name = f"{k:02}.jpg"
        centre = np.array([10.0 * (k % 6), 25.0 * (k // 6), 60.0 + rng.normal()])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = down, -down @ centre
        truth[name] = centre
        images[name] = MapImage(name, camera, pose, np.zeros((0, 2)), np.zeros(0, np.int64))
    ground = np.column_stack([rng.uniform(-20, 80, (500, 2)), rng.normal(size=500)])
    count = len(ground)
    colours, error = np.zeros((count, 3), np.uint8), np.zeros(count)
    model = SparseMap(images, ground, colours, error, np.full(count, 2))
    fixes = {name: centre + rng.normal(size=3) / 10 for name, centre in truth.items()}
    for name in list(fixes)[altitudes:]:
        fixes[name][2] = np.nan
    return model, fixes, truth


@pytest.mark.parametrize(("altitudes", "level"), [(12, "gps"), (7, "gps"), (2, "ground")])
def test_fixes_without_an_altitude(altitudes: int, level: str) -> None:
    model, fixes, truth = made_flight(altitudes)
    fixes["11.jpg"] = fixes["11.jpg"] + [40.0, 0.0, 0.0]
    placed = georegister(lose(model), fixes)
    assert placed.level == level
    assert placed.blunders == ("11.jpg",)
    found = placed.apply(lose(model).centres)
    assert np.abs(found - [truth[name] for name in model.names]).max() < 1.0
    assert np.isfinite(placed.sigma).all()
