"""The leaderboard of all tracks in one HTML file, from ``templates/board.*``."""

from __future__ import annotations

from collections.abc import Sequence

from benchmark.report.board import paper_table
from benchmark.report.board.difficulty import AXES
from benchmark.report.board.figures import track_figures
from benchmark.report.board.pictures import Pictures
from benchmark.report.board.runs import TrackBoard
from benchmark.report.page import paper_of
from benchmark.report.self_contained import fill
from benchmark.scoring.score import THRESHOLDS
from objconnect.scene.runtime.progress import progress_bar


def board_page(boards: Sequence[TrackBoard]) -> str:
    """Return the leaderboard of all tracks as HTML.

    Raises:
        InputError: a track's file of thumbnails (``benchmark.report.album``) is damaged.
    """
    tracks = []
    pictures = Pictures()
    with progress_bar("tracks", len(boards)) as advance:
        for done, board in enumerate(boards, 1):
            tracks.append(track_figures(board) | {"pictures": pictures.add_track(board)})
            advance(done)
    data = {
        "thresholds": [{"key": t.key, "text": str(t)} for t in THRESHOLDS],
        "axes": [
            {
                "key": axis.key,
                "short": axis.short,
                "title": axis.title,
                "unit": axis.unit,
                "labels": axis.labels,
                "column": axis.column,
            }
            for axis in AXES
        ],
        "tracks": tracks,
        "pictures": pictures.encoded,
        "paper": paper_of(paper_table.columns(), paper_table.note(), paper_table.lines(boards)),
    }
    return fill("board", data, base="shared")
