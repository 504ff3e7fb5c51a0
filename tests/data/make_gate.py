"""Writes ``tests/data/gate`` from the scene of ``configs/gate.yaml``:

    objconnect simulate --config gate --out runs/gate
    objconnect map runs/gate
    python -m tests.data.make_gate runs/gate tests/data/gate

A flight of photographs, small enough to be kept in the repository: rendering it again on another
processor may change a pixel, and a baseline must be of the very same data.
"""

from __future__ import annotations

import csv
import shutil
import sys
from pathlib import Path

import torch

from benchmark.datasets.dataset import Dataset
from benchmark.datasets.open import open_datasets
from scene.geometry.pose import Pose


def make(scene: Path, out: Path) -> None:
    """Copy a scene's map, photographs, queries, reference poses and priors; no depth."""
    (dataset,) = open_datasets(scene)
    names = [*dataset.load_map().names, *(query.name for query in dataset.queries)]
    for name in names:
        path = out / "images" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(dataset.images / name, path)
    shutil.copytree(
        scene / "map", out / "sparse" / "map", ignore=lambda _, files: _not_model(files)
    )
    queries = dataset.queries
    (out / "queries.txt").write_text("".join(f"{q.name} {q.camera}\n" for q in queries))
    (out / "reference_poses.txt").write_text("".join(_pose(q.name, q.reference) for q in queries))
    _write_priors(dataset, out / "priors.csv")


def _not_model(files: list[str]) -> set[str]:
    return {name for name in files if not name.endswith(".bin")}


def _pose(name: str, pose: Pose) -> str:
    numbers = [*pose.quaternion().tolist(), *pose.translation.tolist()]
    return " ".join([name, *(repr(number) for number in numbers)]) + "\n"


def _write_priors(dataset: Dataset, path: Path) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["name", *"enu", "sigma_m", "qw", "qx", "qy", "qz", "sigma_deg"])
        for query in dataset.queries:
            prior = query.prior
            assert prior is not None
            assert prior.position_sigma is not None
            assert prior.cam_from_world_rotation is not None
            rotation = torch.from_numpy(prior.cam_from_world_rotation)
            attitude = Pose(rotation, torch.zeros(3, dtype=torch.float64)).quaternion()
            row = [*prior.position, float(prior.position_sigma.max()), *attitude.tolist()]
            writer.writerow([query.name, *(f"{x:.6f}" for x in row), prior.attitude_sigma_deg])


if __name__ == "__main__":
    make(Path(sys.argv[1]), Path(sys.argv[2]))
