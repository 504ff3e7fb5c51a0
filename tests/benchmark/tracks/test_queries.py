from __future__ import annotations

from pathlib import Path

import pytest

from benchmark.tracks.difficulty import Difficulty, QueryRow, write_queries
from benchmark.tracks.queries import read_queries
from objconnect.scene.errors import InputError

HEAD = "name,condition,flight,part,overlap,scale,angle_deg,days\n"
ROWS = [
    QueryRow("snow/images/000001.jpg", "snow-noon", "snow", "park", Difficulty(0.5, 1.25, 12.3, 9)),
    QueryRow(
        "snow/images/000002.jpg", "snow-noon", "snow", "park", Difficulty(0, None, None, None)
    ),
]


def test_a_list_survives_writing_and_reading(tmp_path: Path) -> None:
    write_queries(tmp_path / "q.csv", ROWS)
    assert list(read_queries(tmp_path / "q.csv")) == ROWS


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("a,snow,f,park,1.5,1,1,1", "overlap '1.5' is not a number from 0 to 1"),
        ("a,snow,f,park,,1,1,1", "overlap is empty"),
        ("a,snow,f,park,0.5,-1,1,1", "scale '-1'"),
        ("a,snow,f,park,0.5,nan,1,1", "scale 'nan'"),
        ("a,snow,f,park,0.5,1,181,1", "angle_deg '181' is not a number from 0 to 180"),
        ("a,snow,f,park,0.5,1,1,200", "days '200' is not a number from 0 to 182"),
        ("a,snow,f,park,0.5,1,1", "expected 8 columns, got 7"),
        (",snow,f,park,0.5,1,1,1", "the name is empty"),
        ("a\x07,snow,f,park,0.5,1,1,1", "has a control character"),
        ("a,changed,f,park,0.5,1,1,1", "the condition 'changed' is a reserved name"),
        ("a,all,f,park,0.5,1,1,1", "the condition 'all' is a reserved name"),
        ("a,snow,f,all,0.5,1,1,1", "the part 'all' is a reserved name"),
        ("b,snow,f,park,0.5,1,1,1", "query b is listed twice"),
    ],
)
def test_errors_name_the_line(line: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "q.csv"
    path.write_text(f"{HEAD}b,snow,f,park,0.5,1,1,1\n{line}\n")
    with pytest.raises(InputError, match=r"q\.csv:3: ") as raised:
        read_queries(path)
    assert says in str(raised.value)


def test_a_list_without_queries_or_columns_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "q.csv"
    path.write_text(HEAD)
    with pytest.raises(InputError, match="lists no query"):
        read_queries(path)
    path.write_text("name,condition\n")
    with pytest.raises(InputError, match="lacks the column flight, part"):
        read_queries(path)
