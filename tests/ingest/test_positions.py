from __future__ import annotations

from pathlib import Path

import pytest

from benchmark.datasets.textfiles import read_gps
from ingest.photographs import Roll, read_roll
from ingest.positions import local, with_positions
from scene.errors import InputError


@pytest.fixture(scope="module")
def roll(photographs: Path) -> Roll:
    return read_roll(photographs)


def test_a_table_takes_the_place_of_exif(roll: Roll, beach: Path, tmp_path: Path) -> None:
    """The flight's own, which has more columns; its metres have another origin."""
    placed = with_positions(roll, beach / "gps.csv")
    ours, theirs = local(placed.shots)[1], read_gps(beach / "gps.csv")
    first = placed.shots[0]
    for shot in placed.shots:
        step = ours[shot.name] - ours[first.name]
        assert step == pytest.approx(theirs[shot.file] - theirs[first.file], abs=0.02)
    table = tmp_path / "gps.csv"
    table.write_text("\ufeffname,lat,lon,alt\nDJI_0020.jpg,46.5,-92,200.5\nother.jpg,1,2,3\n")
    known = [shot for shot in with_positions(roll, table).shots if shot.exif.position]
    assert [shot.file for shot in known] == ["DJI_0020.jpg"]
    assert known[0].exif.position == (46.5, -92, 200.5)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "has no column name"),
        ("name,lat,lon\nDJI_0020.jpg,1,2\n", "has no column alt: its first line must name"),
        ("name,lat,lon,alt\nDJI_0020.jpg,1,2,\n", "line 2: lat, lon and alt must be"),
        ("name,lat,lon,alt\nDJI_0020.jpg,91,2,3\n", "line 2: lat, lon and alt must be"),
        ("name,lat,lon,alt\nDJI_0020.jpg,1,2,nan\n", "line 2: lat, lon and alt must be"),
        ("name,lat,lon,alt\nDJI_0020.jpg,1,2\n", "line 2: lat, lon and alt must be"),
        ("name,lat,lon,alt\nb.jpg,1,2,3\nb.jpg,1,2,4\n", "line 3: b.jpg is there twice"),
        ("name,lat,lon,alt\nb.jpg,1,2,3\n", "has none of the photographs: its first name is 'b"),
    ],
)
def test_tables_that_are_wrong(roll: Roll, tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "gps.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        with_positions(roll, tmp_path / "gps.csv")
    with pytest.raises(InputError, match="cannot read table of positions"):
        with_positions(roll, tmp_path / "missing.csv")
