"""Makes a scene in ``benchmark/gate`` from the configuration of its name:

    python -m tests.data.make_gate gate-snow

It is a flight of photographs, small enough to be kept in the repository: rendering it again on
another processor may change a pixel, and a baseline must be of the very same data.
"""

from __future__ import annotations

import csv
import shutil
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

import torch

from benchmark.datasets.dataset import BenchmarkQuery
from benchmark.datasets.open import open_datasets
from benchmark.gate.scene import GATE_SCENES
from objconnect.mapping.build import build_map
from objconnect.scene.config import load_config
from objconnect.scene.geometry.pose import Pose
from simulate.command import simulate
from simulate.config import SimulateConfig

ROOT: Final = Path(__file__).parents[2]


def make(name: str) -> None:
    """Render and map the scene of a configuration in ``runs/``, and copy it into the package."""
    scene = ROOT / "runs" / name
    simulate(load_config(SimulateConfig, Path(name), {}), scene)
    if not (scene / "map").exists():
        build_map(scene)
    copy(scene, GATE_SCENES[name])


def copy(scene: Path, out: Path) -> None:
    """Copy a scene's map, photographs, queries, reference poses, priors, conditions; no depth."""
    (dataset,) = open_datasets(scene)
    queries = [query for query in dataset.queries if _is_kept(query, out.name)]
    names = [*dataset.load_map().names, *(query.name for query in queries)]
    for name in names:
        path = out / "images" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(dataset.images / name, path)
    shutil.copytree(
        scene / "map", out / "sparse" / "map", ignore=lambda _, files: _not_model(files)
    )
    (out / "queries.txt").write_text("".join(f"{q.name} {q.camera}\n" for q in queries))
    (out / "reference_poses.txt").write_text("".join(_pose(q.name, q.reference) for q in queries))
    _write_priors(queries, out / "priors.csv")
    (mapped,) = dataset.map_conditions
    conditions = dict.fromkeys(names, mapped) | {q.name: q.condition for q in queries}
    _write_table(out / "conditions.csv", ["name", "condition"], conditions.items())


def _is_kept(query: BenchmarkQuery, scene: str) -> bool:
    """Each query costs every method time: 8 in summer and 32 in snow of ``gate-snow`` suffice."""
    third = int(Path(query.name).stem) % 3 == 0
    return scene != "gate-snow" or third == (query.condition == "summer-noon")


def _not_model(files: list[str]) -> set[str]:
    return {name for name in files if not name.endswith(".bin")}


def _pose(name: str, pose: Pose) -> str:
    numbers = [*pose.quaternion().tolist(), *pose.translation.tolist()]
    return " ".join([name, *(repr(number) for number in numbers)]) + "\n"


def _write_priors(queries: Iterable[BenchmarkQuery], path: Path) -> None:
    rows = []
    for query in queries:
        prior = query.prior
        assert prior is not None
        assert prior.position_sigma is not None
        assert prior.cam_from_world_rotation is not None
        rotation = torch.from_numpy(prior.cam_from_world_rotation)
        attitude = Pose(rotation, torch.zeros(3, dtype=torch.float64)).quaternion()
        row = [*prior.position, float(prior.position_sigma.max()), *attitude.tolist()]
        rows.append((query.name, *(f"{x:.6f}" for x in row), prior.attitude_sigma_deg))
    header = ["name", *"enu", "sigma_m", "qw", "qx", "qy", "qz", "sigma_deg"]
    _write_table(path, header, rows)


def _write_table(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


if __name__ == "__main__":
    make(sys.argv[1])
