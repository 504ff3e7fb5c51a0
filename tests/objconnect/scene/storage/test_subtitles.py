"""Times of subtitles, in the forms in which programs write them."""

from __future__ import annotations

from pathlib import Path

import pytest

from objconnect.scene.storage.subtitles import read_subtitles

pytest.importorskip("srt")


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["00:00:01,500 --> 00:00:02,750"], [(1.5, 2.75)]),
        (["00:00:01.500-->00:00:02.750"], [(1.5, 2.75)]),
        (["01:02:03,004 --> 01:02:04,005"], [(3723.004, 3724.005)]),
        # WebVTT without hours, with settings.
        (["00:01.500 --> 00:02.750 align:start position:0%"], [(1.5, 2.75)]),
        (["02:01.500 --> 1:02:02.750"], [(121.5, 3722.75)]),
        (["00:00:01 --> 00:00:02"], [(1.0, 2.0)]),
        (["00:00:01,50 --> 00:00:02,75"], [(1.5, 2.75)]),
        (["00:00:01,500000 --> 00:00:02,750000"], [(1.5, 2.75)]),
        # Milliseconds without leading zeros.
        (
            ["00:00:00,0 --> 00:00:00,33", "00:00:00,99 --> 00:00:00,132"],
            [(0, 0.033), (0.099, 0.132)],
        ),
    ],
)
def test_times_are_those_that_are_meant(
    tmp_path: Path, lines: list[str], expected: list[tuple[float, float]]
) -> None:
    path = tmp_path / "a.srt"
    path.write_text("".join(f"{k + 1}\n{line}\nwords\n\n" for k, line in enumerate(lines)))
    found = [(item.start_s, item.end_s) for item in read_subtitles(path)]
    assert found == [pytest.approx(each) for each in expected]


def test_a_number_of_thousands_of_digits_is_marked_as_cut(tmp_path: Path) -> None:
    """The parser would take minutes for it."""
    path = tmp_path / "a.srt"
    path.write_text(f"x{'9' * 5000}x\n\n2\n00:00:01,000 --> 00:00:02,000\n{'9' * 5000}\n")
    (found,) = read_subtitles(path)
    assert (found.start_s, found.text) == (1, "9" * 100 + "\ufffd")
