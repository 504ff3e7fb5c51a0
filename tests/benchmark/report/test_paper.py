from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from benchmark.report.paper import REPORTED, columns, side_by_side
from benchmark.report.tables import Group, groups
from tests.benchmark.report.test_leaderboard import run


@pytest.fixture
def group(scene: Path, tmp_path: Path) -> Group:
    (found,) = groups([run(scene, tmp_path, "sift")])
    return found


def test_the_papers_lines_are_labelled() -> None:
    lines = side_by_side([])
    assert [line.source for line in lines] == [REPORTED] * 3
    values = {line.method: [cell.value for cell in line.cells if cell] for line in lines}
    assert values == {
        "D2-Net": [89.3, 75.1, 51.4, 90.5],
        "PixLoc": [90.4, 81.1, 62.5, 93.8],
        "object-connect": [91.1, 83.4, 65.6, 94.3],
    }
    assert all(cell is not None and cell.low is None for line in lines for cell in line.cells)


def test_ours_stand_in_the_column_they_belong_to(group: Group) -> None:
    slices = [
        replace(group, track="cmu", dataset=f"cmu-urban-slice{number}", sha256=str(number))
        for number in (2, 3)
    ]
    # Simulated drives in the tree of CMU are not CMU, whatever they are called.
    imitation = replace(slices[0], track="cmu-sim", sha256="4")
    (ours,) = side_by_side([group, *slices, imitation])[3:]
    assert (ours.method, ours.reported) == ("sift", False)
    cells = dict(zip(columns(), ours.cells, strict=True))
    assert cells["CMU suburban"] is None
    assert cells["CMU park"] is None
    urban, simulated = cells["CMU urban"], cells["simulated UAV"]
    assert urban is not None
    assert simulated is not None
    # Three of six queries within 0.5 m, twice.
    assert (urban.value, urban.queries) == (50, 12)
    assert simulated.queries == 6
    assert simulated.text() == "50.0 [–] of 6"


def test_starts_are_not_pooled(group: Group) -> None:
    lines = side_by_side([group, replace(group, start="none")])[3:]
    assert [line.source for line in lines] == [
        "measured here, start: each query's own prior",
        "measured here, start: no prior",
    ]
