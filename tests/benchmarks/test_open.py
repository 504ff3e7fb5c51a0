"""Opening a data set of 1000 photographs a second time: read the ratio, not the seconds.

Held against what no opening can do without: reading map, queries and poses, and asking the file
system once for every photograph. ``make bench``; the ordinary test run executes each once, to keep
them working.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from time import perf_counter

import pytest
import torch
from pytest_benchmark.fixture import BenchmarkFixture

import objconnect.scene.storage.digests
from benchmark.datasets.flight import gps_sigma
from benchmark.datasets.open import open_datasets
from objconnect.scene.flights.textfiles import read_cameras, read_gps, read_poses
from objconnect.scene.maps.colmap_files import read_model
from tests.benchmark.made_data import CAMERA, pose_at, write_model

pytestmark = pytest.mark.thorough

MAPPED, ASKED = 700, 300
# What matters the first time alone.
BYTES = 20_000
ROUNDS = 5


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A flight whose digests are remembered."""
    path = tmp_path_factory.mktemp("large") / "flight"
    names = [f"DJI_{k:04d}.JPG" for k in range(MAPPED + ASKED)]
    poses = {name: pose_at(k) for k, name in enumerate(names)}
    (path / "images").mkdir(parents=True)
    for k, name in enumerate(names):
        (path / "images" / name).write_bytes(k.to_bytes(4, "little") * (BYTES // 4))
    write_model(path / "sparse" / "map", {name: poses[name] for name in names[:MAPPED]})
    (path / "queries.txt").write_text("".join(f"{name} {CAMERA}\n" for name in names[MAPPED:]))
    lines, rows = [], ["name,split,lat,lon,alt,e,n,u"]
    for name, pose in poses.items():
        numbers = [*pose.quaternion().tolist(), *pose.translation.tolist()]
        lines.append(" ".join([name, *(repr(x) for x in numbers)]))
        e, n, u = (pose.centre() + torch.tensor([0.3, -0.4, 2.0])).tolist()
        rows.append(f"{name},any,0,0,0,{e},{n},{u}")
    (path / "reference_poses.txt").write_text("\n".join(lines[MAPPED:]) + "\n")
    (path / "gps.csv").write_text("\n".join(rows) + "\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            objconnect.scene.storage.digests, "_TICK_NS", -(10**18)
        )  # they were written just now
        open_dataset(path)
        yield path


def open_dataset(path: Path) -> str:
    (dataset,) = open_datasets(path)
    return dataset.sha256


def bare(path: Path) -> None:
    sparse_map = read_model(path / "sparse" / "map")
    queries = read_cameras(path / "queries.txt")
    read_poses(path / "reference_poses.txt")
    gps_sigma(read_gps(path / "gps.csv"), sparse_map)
    for name in (*sparse_map.names, *queries):
        (path / "images" / name).stat()


@pytest.mark.benchmark(group="open 1000 photographs again")
def test_opened_again(benchmark: BenchmarkFixture, flight: Path) -> None:
    took = {bare: float("inf"), open_dataset: float("inf")}
    for _ in range(ROUNDS if benchmark.enabled else 1):
        for what in took:  # in turns, for the machine has other things to do
            began = perf_counter()
            what(flight)
            took[what] = min(took[what], perf_counter() - began)
    benchmark.extra_info["ratio"] = took[open_dataset] / took[bare]
    if benchmark.enabled:
        print(f"\nopened again: {took[open_dataset] / took[bare]:.2f} of what is bare")
    assert len(benchmark(open_dataset, flight)) == 64


@pytest.mark.benchmark(group="open 1000 photographs again")
def test_bare(benchmark: BenchmarkFixture, flight: Path) -> None:
    benchmark(bare, flight)
