from __future__ import annotations

from pathlib import Path

import pytest

from benchmark.datasets.open import open_datasets
from benchmark.evaluation.starts import parse_start
from experiments.ablation import TABLE, Plan, ablate
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.config import load_config
from objconnect.scene.errors import InputError

NOTHING = {"segmentation": "none", "attention": False, "object_graph": False, "scene_graph": False}
TINY = {"steps": 2, "batch": 2, "crop": 96, "points": 64, "workers": 0, "warm_up": 0.0}
SMALL = {"references": 2, "corners": None}


def plan(*variants: dict[str, object]) -> Plan:
    return load_config(Plan, None, {"training": TINY, "variants": list(variants)})


@pytest.mark.thorough
def test_variants_are_trained_and_asked_once_and_stand_in_one_table(
    rendered: Scene, tmp_path: Path
) -> None:
    datasets = list(open_datasets(rendered.path))
    comparison = plan(
        {"name": "no objects", "network": NOTHING, "method": SMALL},
        {"name": "one start", "network": NOTHING, "method": {**SMALL, "multistart": False}},
        {"name": "objects, both graphs", "method": SMALL},
    )

    def run() -> str:
        start = parse_start("error=1m,2deg")
        return ablate(comparison, [rendered.path], [], datasets, tmp_path, start)

    table = run()
    assert (tmp_path / TABLE).read_text() == table
    header, _, *rows = table.splitlines()
    assert "summer-noon (4)" in header and "winter-dusk (3)" in header
    assert [row.split("|")[1].strip() for row in rows] == [
        "no objects",
        "one start",
        "objects, both graphs",
    ]
    assert all("lost, p = " in row for row in rows[1:])
    # One training for the two that differ in how they are used, and nothing twice.
    trained = sorted(path.parent.parent.name for path in tmp_path.glob("*/training/weights.*"))
    assert trained == ["no-objects", "objects-both-graphs"]
    results = sorted(tmp_path.glob("*/*/objconnect.json"))
    assert len(results) == 3
    before = [path.stat().st_mtime_ns for path in results]
    assert run() == table
    assert [path.stat().st_mtime_ns for path in results] == before


def test_names_and_switches_are_looked_at_before_anything_is_trained() -> None:
    with pytest.raises(InputError, match="two variants have one name"):
        plan({"name": "a b"}, {"name": "a-b"})
    with pytest.raises(InputError, match=r"bad value for 'variants\.0\.name'"):
        plan({"name": "../out"}, {"name": "b"})
    with pytest.raises(InputError, match="bad value for 'variants'"):
        plan({"name": "alone"})
    with pytest.raises(InputError, match="there are no objects: switch attention"):
        plan({"name": "a"}, {"name": "b", "network": {"segmentation": "none"}})
    with pytest.raises(InputError, match=r"unknown key 'variants\.1\.method\.start_at'"):
        plan({"name": "a"}, {"name": "b", "method": {"start_at": 3}})
