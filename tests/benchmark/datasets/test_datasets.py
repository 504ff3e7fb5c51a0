from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from benchmark.datasets.dataset import Dataset
from benchmark.datasets.flight import gps_sigma
from benchmark.datasets.open import open_datasets
from objconnect.scene.errors import InputError
from objconnect.scene.flights.textfiles import read_priors
from objconnect.scene.maps.colmap_files import read_model
from tests.benchmark.made_data import (
    MAP_NAMES,
    QUERY_NAMES,
    pose_at,
    write_flight,
    write_model,
    write_scene,
)


def only(path: Path) -> Dataset:
    (dataset,) = open_datasets(path)
    return dataset


def test_a_flight_opens_with_its_map_and_queries(made_flight: Path) -> None:
    dataset = only(made_flight)
    assert (dataset.name, dataset.track) == ("meadow", "flight")
    assert dataset.map_conditions == ("same-flight",)
    assert [query.name for query in dataset.queries] == list(QUERY_NAMES)
    assert dataset.load_map().names == MAP_NAMES
    for query, index in zip(dataset.queries, (1, 3, 5), strict=True):
        metres, degrees = query.reference.error_to(pose_at(index))
        assert float(metres) < 1e-9
        assert float(degrees) < 1e-7
        loaded = query.load()
        assert loaded.image.shape == (64, 96, 3)
        assert loaded.prior is None
        assert query.prior is not None


def _declare(flight: Path, queries: str = "winter-dusk") -> Path:
    """Write a table that says: the map of summer, and queries of another condition."""
    table = flight / "conditions.csv"
    rows = [f"{name},summer-noon" for name in MAP_NAMES] + [f"{n},{queries}" for n in QUERY_NAMES]
    table.write_text("\n".join(["name,condition", *rows]) + "\n")
    return table


def test_a_flight_declares_its_conditions(made_flight: Path) -> None:
    """A winter flight over a summer map is not the map's own condition, and not saturated."""
    same = only(made_flight).sha256
    _declare(made_flight)
    dataset = only(made_flight)
    assert dataset.map_conditions == ("summer-noon",)
    assert {query.condition for query in dataset.queries} == {"winter-dusk"}
    assert dataset.sha256 != same


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ("all", "'all' stands for all conditions"),
        (" ", "the condition is empty"),
        ("win\x07ter", "has a control character"),
    ],
)
def test_bad_tables_of_conditions_are_refused(made_flight: Path, wrong: str, why: str) -> None:
    table = _declare(made_flight, wrong)
    with pytest.raises(InputError, match=rf"{table}:6: .*{why}"):
        only(made_flight)


def test_a_table_of_conditions_has_all_photographs(made_flight: Path) -> None:
    table = _declare(made_flight)
    lines = table.read_text().splitlines()
    table.write_text("\n".join(lines[:-1]) + "\n")
    with pytest.raises(InputError, match=f"has no condition for {QUERY_NAMES[-1]}"):
        only(made_flight)


def test_gps_sigma_is_the_rms_over_map_photographs(made_flight: Path) -> None:
    prior = only(made_flight).queries[0].prior
    assert prior is not None
    assert prior.position_sigma == pytest.approx([0.3, 0.4, 2.0], abs=1e-6)
    assert prior.cam_from_world_rotation is None


def test_gps_of_queries_does_not_change_the_sigma(made_flight: Path) -> None:
    before = only(made_flight).queries[0].prior
    table = made_flight / "gps.csv"
    lines = table.read_text().splitlines()
    moved = [",".join([*line.split(",")[:5], "999", "999", "999"]) for line in lines[2:3]]
    table.write_text("\n".join([*lines[:2], *moved, *lines[3:]]) + "\n")
    after = only(made_flight).queries[0].prior
    assert before is not None
    assert after is not None
    assert after.position.tolist() == [999, 999, 999]
    assert after.position_sigma == pytest.approx(before.position_sigma)


def test_too_few_fixes_give_no_sigma(made_flight: Path) -> None:
    sparse_map = read_model(made_flight / "sparse" / "map")
    assert gps_sigma({name: np.zeros(3) for name in MAP_NAMES[:2]}, sparse_map) is None


def test_priors_file_wins_over_gps(made_flight: Path) -> None:
    (made_flight / "priors.csv").write_text(
        "name,e,n,u,sigma_m,qw,qx,qy,qz,sigma_deg\nb.jpg,1,2,3,8,0,1,0,0,10\n"
    )
    first, second, _ = only(made_flight).queries
    assert first.prior is not None
    assert first.prior.position.tolist() == [1, 2, 3]
    assert first.prior.position_sigma is not None
    assert first.prior.position_sigma.tolist() == [8, 8, 8]
    assert first.prior.cam_from_world_rotation == pytest.approx(np.diag([1.0, -1, -1]))
    assert first.prior.attitude_sigma_deg == 10
    assert second.prior is None


def test_priors_need_positive_sigmas(tmp_path: Path) -> None:
    path = tmp_path / "priors.csv"
    path.write_text("name,e,n,u,sigma_m,qw,qx,qy,qz,sigma_deg\nb.jpg,1,2,3,0,0,1,0,0,10\n")
    with pytest.raises(InputError, match=r"priors\.csv:2: sigma_m and sigma_deg must be positive"):
        read_priors(path)


def test_flight_without_gps_has_no_prior(made_flight: Path) -> None:
    (made_flight / "gps.csv").unlink()
    assert [query.prior for query in only(made_flight).queries] == [None] * 3


def test_a_hard_split_is_a_data_set_of_its_own(made_flight: Path) -> None:
    for stem in ("queries", "reference_poses"):
        shutil.copy(made_flight / f"{stem}.txt", made_flight / f"{stem}_sparse.txt")
    poses = {name: pose_at(2 * k) for k, name in enumerate(MAP_NAMES[:3])}
    write_model(made_flight / "sparse" / "map_sparse", poses)
    assert [d.name for d in open_datasets(made_flight)] == ["meadow", "meadow-sparse"]
    alone = only(made_flight.with_name("meadow-sparse"))
    assert alone.name == "meadow-sparse"
    assert len(alone.load_map().names) == 3
    assert alone.sha256 != open_datasets(made_flight)[0].sha256


def test_a_missing_hard_split_is_refused(made_flight: Path) -> None:
    with pytest.raises(InputError, match=r"queries_sparse\.txt"):
        open_datasets(made_flight.with_name("meadow-sparse"))


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("reference_poses.txt", "b.jpg 0.0 1.0", "b.jpg 1.0 0.0"),
        ("queries.txt", "b.jpg SIMPLE_RADIAL 96 64 80.0", "b.jpg SIMPLE_RADIAL 96 64 80.1"),
        ("gps.csv", "b.jpg,query,0,0,0,-", "b.jpg,query,0,0,0,-1"),
    ],
)
def test_the_digest_covers_everything_that_is_scored(
    made_flight: Path, file: str, old: str, new: str
) -> None:
    before = only(made_flight).sha256
    text = (made_flight / file).read_text()
    assert old in text
    (made_flight / file).write_text(text.replace(old, new))
    assert only(made_flight).sha256 != before


def test_the_digest_covers_pixels_and_not_the_folder(tmp_path: Path) -> None:
    first = only(write_flight(tmp_path / "one" / "meadow"))
    second_path = write_flight(tmp_path / "two" / "meadow")
    assert only(second_path).sha256 == first.sha256
    shutil.copy(second_path / "images" / "d.jpg", second_path / "images" / "b.jpg")
    assert only(second_path).sha256 != first.sha256


def test_a_scene_opens_with_its_map_and_queries(scene: Path) -> None:
    dataset = only(scene)
    assert (dataset.name, dataset.track) == ("hamlet", "uav-sim")
    assert dataset.map_conditions == ("summer-noon",)
    assert [query.condition for query in dataset.queries] == ["summer-noon"] * 3 + [
        "winter-dusk"
    ] * 3
    query = dataset.queries[3]
    assert query.name == "winter-grid/images/000000.jpg"
    assert float(query.reference.error_to(pose_at(2))[0]) < 1e-9
    assert (query.group, query.load().prior) == ("winter-grid", None)
    prior = query.prior
    assert prior is not None
    assert prior.position == pytest.approx(pose_at(2).centre().numpy() + 1)
    assert prior.cam_from_world_rotation == pytest.approx(pose_at(2).rotation.numpy())
    assert (dataset.images / "summer-nadir/images/000000.jpg").is_file()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "summer-grid/images/000000.jpg",
            "summer-grid/images/000009.jpg",
            "is not a frame of session",
        ),
        ('"winter-grid":', '"autumn-grid":', "has no session 'autumn-grid'"),
    ],
)
def test_a_scene_with_contradicting_lists_is_refused(
    scene: Path, old: str, new: str, message: str
) -> None:
    splits = scene / "splits.json"
    splits.write_text(splits.read_text().replace(old, new))
    with pytest.raises(InputError, match=message):
        open_datasets(scene)


def test_unfinished_scene_is_no_data_set(tmp_path: Path) -> None:
    path = write_scene(tmp_path / "hamlet")
    (path / "scene.json").unlink()
    with pytest.raises(InputError, match="is not a data set"):
        open_datasets(path)


@pytest.mark.parametrize("name", ["brighton_beach", "caliterra"])
def test_real_flights_open(flights: Path, name: str) -> None:
    whole, hard = open_datasets(flights / name)
    assert (whole.name, hard.name) == (name, f"{name}-sparse")
    assert only(flights / f"{name}-sparse").sha256 == hard.sha256
    for dataset in (whole, hard):
        sparse_map = dataset.load_map()
        for query in dataset.queries:
            assert query.name not in sparse_map.images
            assert query.prior is not None
            assert query.prior.position_sigma is not None
            # The reference poses are over the ground the map covers.
            gaps = np.linalg.norm(sparse_map.centres - query.reference.centre().numpy(), axis=1)
            assert gaps.min() < 60


def test_the_gps_sigma_of_real_flights_is_plausible(flights: Path) -> None:
    """The README of the flights states 0.55 m and 16.5 m horizontally, over all photographs."""
    for name, horizontal in (("brighton_beach", 0.55), ("caliterra", 16.5)):
        prior = open_datasets(flights / name)[0].queries[0].prior
        assert prior is not None
        assert prior.position_sigma is not None
        assert np.hypot(*prior.position_sigma[:2]) == pytest.approx(horizontal, rel=0.1)
