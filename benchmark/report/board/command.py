"""The leaderboard of all tracks, from their stored results."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from benchmark.report.board.page import board_page
from benchmark.report.board.runs import TrackBoard, read_boards
from benchmark.report.board.text import HeadlineRow, board_markdown, headline
from benchmark.report.leaderboard import MARKS
from benchmark.tracks.description import TRACKS_FOLDER
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.outputs import OutputFile, check_outputs

_MARKDOWN: Final = "leaderboard.md"
_PAGE: Final = "leaderboard.html"


@dataclass(frozen=True)
class BoardReport:
    """The main metrics of all benchmark tracks.

    Attributes:
        boards: the tracks.
        rows: for each track the metrics of every prior, group of queries and method.
    """

    boards: tuple[TrackBoard, ...]
    rows: tuple[tuple[HeadlineRow, ...], ...]

    def text(self) -> str:
        """Return the figures as Markdown."""
        return board_markdown(self.boards, self.rows)

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for a program."""
        tracks = zip(self.boards, self.rows, strict=True)
        return {
            "tracks": [
                {"name": board.track.name, "missing": board.missing, "rows": rows}
                for board, rows in tracks
            ]
        }


def board(folder: Path = TRACKS_FOLDER, out: Path | None = None) -> BoardReport:
    """Compare the stored results of all tracks.

    Args:
        folder: folder of the tracks, ``folder/<track>/track.yaml`` with ``queries`` and
            ``results``.
        out: folder for ``leaderboard.md`` and ``leaderboard.html``; None writes no file.

    Raises:
        InputError: there is no track, a file is damaged, results are of other data or queries than
            the track's, or ``out`` cannot be written.
    """
    if out is not None:
        names = (_MARKDOWN, _PAGE)
        check_outputs((OutputFile(out / name, MARKS[name]) for name in names), [folder], within=out)
    boards = tuple(read_boards(folder))
    report = BoardReport(boards, tuple(tuple(headline(one)) for one in boards))
    if out is not None:
        page = board_page(boards)
        write_text(out / _MARKDOWN, report.text())
        write_text(out / _PAGE, page)
    return report
