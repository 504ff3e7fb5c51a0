from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.datasets.dataset import Dataset
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.evaluate import evaluate
from benchmark.evaluation.starts import gravity_prior, move_prior, parse_start, position_prior
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose
from tests.benchmark.made_data import MAP_NAMES, FakeLocalizer, pose_at


@pytest.fixture
def meadow(made_flight: Path) -> Dataset:
    (dataset,) = open_datasets(made_flight)
    return dataset


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("prior", "prior"),
        ("none", "none"),
        ("retrieval", "retrieval=10"),
        ("retrieval=3", "retrieval=3"),
        ("error=3m,5deg", "error=3m,5deg"),
        ("error=0.50m,10.0deg", "error=0.5m,10deg"),
        ("gravity", "gravity=3deg"),
        ("gravity=0.5deg", "gravity=0.5deg"),
        ("gps=50m", "gps=50m"),
    ],
)
def test_starts_have_canonical_names(text: str, name: str) -> None:
    assert parse_start(text).name == name


@pytest.mark.parametrize(
    "text",
    [
        "",
        "luck",
        "retrieval=0",
        "retrieval=",
        "error=3",
        "error=1.2.3m,5deg",
        "error=m,deg",
        "gps=50",
        "gps=1e9m",
        "gravity=3",
        "gravity=181deg",
        "gravity=1.2.3deg",
    ],
)
def test_unknown_starts_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="start"):
        parse_start(text)


@pytest.mark.parametrize(("metres", "degrees"), [(3.0, 5.0), (0.0, 10.0), (12.0, 0.0)])
def test_the_error_of_a_prior_has_the_stated_size(metres: float, degrees: float) -> None:
    reference = pose_at(3)
    prior = move_prior(reference, "d.jpg", metres, degrees)
    assert prior.cam_from_world_rotation is not None
    rotation = torch.from_numpy(prior.cam_from_world_rotation)
    pose = Pose(rotation, -(rotation @ torch.from_numpy(prior.position)))
    found = pose.error_to(reference)
    assert [float(part) for part in found] == pytest.approx([metres, degrees], abs=1e-6)


def test_gravity_has_the_stated_error_and_no_heading_or_position() -> None:
    reference, down = pose_at(3), torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64)
    headings = set()
    for name in ("a.jpg", "b.jpg", "c.jpg"):
        prior = gravity_prior(reference, name, 3.0)
        assert prior.cam_from_world_rotation is not None
        told = torch.from_numpy(prior.cam_from_world_rotation) @ down
        true = reference.rotation @ down
        assert math.degrees(math.acos(float(told @ true))) == pytest.approx(3.0, abs=1e-6)
        assert not prior.has_position and not prior.has_heading
        turned = prior.cam_from_world_rotation @ reference.rotation.numpy().T
        headings.add(round(math.acos((turned.trace() - 1) / 2), 1))
    assert len(headings) == 3


def test_a_position_prior_has_no_attitude() -> None:
    prior = position_prior(pose_at(3), "d.jpg", 50.0)
    off = np.linalg.norm(prior.position - pose_at(3).centre().numpy())
    assert off == pytest.approx(50.0) and prior.cam_from_world_rotation is None
    assert prior.has_position and not prior.has_heading


def test_the_name_of_a_query_determines_the_direction_of_its_error() -> None:
    first, again, other = (
        move_prior(pose_at(0), name, 3, 5) for name in ("a.jpg", "a.jpg", "b.jpg")
    )
    assert (first.position == again.position).all()
    assert (first.position != other.position).all()


@pytest.mark.parametrize("start", ["gravity=3deg", "gps=50m"])
def test_results_of_partial_starts_are_written(meadow: Dataset, tmp_path: Path, start: str) -> None:
    localizer = FakeLocalizer({})
    assert evaluate(meadow, localizer, tmp_path, parse_start(start)).start == start
    for seen in localizer.seen:
        assert seen.prior is not None and not seen.prior.has_heading


def test_error_start_reaches_the_method(meadow: Dataset, tmp_path: Path) -> None:
    localizer = FakeLocalizer({})
    start = parse_start("error=3m,5deg")
    assert evaluate(meadow, localizer, tmp_path, start).start == "error=3m,5deg"
    for seen, query in zip(localizer.seen, meadow.queries, strict=True):
        assert seen.prior is not None
        away = torch.from_numpy(seen.prior.position) - query.reference.centre()
        assert float(away.norm()) == pytest.approx(3)


def test_pairs_reach_the_method(meadow: Dataset, tmp_path: Path) -> None:
    file = tmp_path / "pairs.txt"
    file.write_text("# hloc\nb.jpg a.jpg\nb.jpg c.jpg\n\nd.jpg c.jpg\nf.jpg g.jpg\n")
    localizer = FakeLocalizer({})
    results = evaluate(meadow, localizer, tmp_path / "out", parse_start(f"pairs={file}"))
    assert results.start.startswith("pairs=")
    assert [seen.references for seen in localizer.seen] == [
        ("a.jpg", "c.jpg"),
        ("c.jpg",),
        ("g.jpg",),
    ]
    assert all(seen.prior is None for seen in localizer.seen)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("b.jpg a.jpg\n", "no photograph of the map for d.jpg"),
        ("b.jpg a.jpg\nd.jpg z.jpg\nf.jpg a.jpg\n", "z.jpg for d.jpg: the map has no such image"),
        ("b.jpg\n", "expected 'query reference'"),
        ("\n", "holds no pair"),
    ],
)
def test_bad_pair_lists_are_refused(
    meadow: Dataset, tmp_path: Path, text: str, message: str
) -> None:
    (tmp_path / "pairs.txt").write_text(text)
    with pytest.raises(InputError, match=message):
        parse_start(f"pairs={tmp_path / 'pairs.txt'}").loader(meadow, meadow.load_map())


def test_retrieval_is_of_the_map(meadow: Dataset) -> None:
    load = parse_start("retrieval=2").loader(meadow, meadow.load_map())
    for query in meadow.queries:
        found = load(query).references
        assert found is not None
        assert len(set(found)) == 2
        assert set(found) <= set(MAP_NAMES)


@pytest.mark.thorough
def test_retrieval_finds_what_overlaps(beach: Path) -> None:
    whole, _ = open_datasets(beach)
    sparse_map = whole.load_map()
    load = parse_start("retrieval=3").loader(whole, sparse_map)
    query = whole.queries[0]
    references = load(query).references
    assert references is not None
    distances = {
        name: float((image.pose.centre() - query.reference.centre()).norm())
        for name, image in sparse_map.images.items()
    }
    nearest = sorted(distances, key=lambda name: distances[name])[: len(distances) // 3]
    assert set(references) & set(nearest)
