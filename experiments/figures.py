"""Insert figures of the stored results into README.md and docs/.

``python -m experiments.figures`` fails where a document differs from the results in
``benchmark/tracks/*/results``; with ``--write`` it mends the documents.

A table stands between two comments, each on a line of its own. The first one names the table and
its arguments, see ``experiments.figure_tables.TABLES``::

    <!-- figures: methods -->
    <!-- figures: recall uav-seasons error=3m,5deg part -->      a row for each kind of place
    <!-- figures: recall uav-seasons none condition all -->      a row for each condition
    <!-- figures: recall street-seasons error=3m,5deg part all -->
    <!-- figures: novelty uav-surprise none -->                 seen and held out of training
    <!-- figures: novelty uav-surprise none sift objconnect --> the same of two methods
    <!-- figures: covariances uav-seasons objconnect -->         NEES by condition and start
    <!-- end -->

A figure in a sentence stands between two comments without spaces. It names track, start, method and
queries, and another figure than the recall where that is asked for, see
``experiments.figure_values``::

    It finds <!--figure:uav-seasons/none/objconnect/changed-->96.4 %<!--end--> of
    <!--figure:uav-seasons/none/objconnect/changed/queries-->1400<!--end--> queries, and wins
    <!--figure:uav-seasons/none/objconnect/snow/won=sift-->552<!--end--> in snow against sift.

The part between the comments may be anything; ``--write`` fills it. Such a comment must not begin a
line, since Markdown takes that for a block (the second line above is wrong). Tables of a command,
such as ``<!-- figures: make demo -->``, are written by that command and stay as they are.
"""

from __future__ import annotations

import argparse
import logging
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Final

from benchmark.report.board.runs import TrackBoard, read_boards
from benchmark.tracks.description import TRACKS_FOLDER
from experiments.figure_tables import table
from experiments.figure_values import value
from objconnect.scene.errors import InputError

ROOT: Final = Path(__file__).parents[1]

_TABLE: Final = re.compile(
    r"(?P<begin>^<!-- figures: (?P<words>[^\n]+?) -->\n)(?P<text>.*?)(?P<end>^<!-- end -->$)",
    re.MULTILINE | re.DOTALL,
)
_FIGURE: Final = re.compile(
    r"(?P<begin><!--figure:(?P<words>[^\s>]+)-->)(?P<text>[^\n]*?)(?P<end><!--end-->)"
)
_AT_LINE_START: Final = re.compile(r"^[ >*-]*<!--figure:(\S+?)-->", re.MULTILINE)
# Beginnings of the names of tables that a command writes; other tests check these tables.
_OF_COMMANDS: Final = ("make ", "python ")


def documents() -> list[Path]:
    """Return the documents that may hold figures."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def insert_figures(boards: Mapping[str, TrackBoard], text: str) -> str:
    """Return a document with the figures of the stored results.

    Raises:
        InputError: a comment names no table or figure, or begins a line within a sentence.
    """
    if misplaced := _AT_LINE_START.search(text):
        raise InputError(f"figure {misplaced[1]} begins a line: move a word before it")
    text = _TABLE.sub(_replacement(lambda words: table(boards, words)), text)
    return _FIGURE.sub(_replacement(lambda words: value(boards, words)), text)


def _replacement(make: Callable[[str], str]) -> Callable[[re.Match[str]], str]:
    def replace(match: re.Match[str]) -> str:
        if match["words"].startswith(_OF_COMMANDS):
            return match[0]
        return match["begin"] + make(match["words"]) + match["end"]

    return replace


def list_stale(boards: Mapping[str, TrackBoard], text: str) -> Iterator[str]:
    """Yield each line of a document that differs from the stored results, and the right line.

    Raises:
        InputError: for the reasons of ``insert_figures``.
    """
    stored = insert_figures(boards, text).splitlines()
    stated = text.splitlines()
    if len(stored) != len(stated):
        yield f"{len(stated)} lines, with the stored results {len(stored)}"
        return
    for number, (stated_line, stored_line) in enumerate(zip(stated, stored, strict=True), 1):
        if stated_line != stored_line:
            yield f"line {number}: {stated_line}\n  stored: {stored_line}"


def stored_results() -> dict[str, TrackBoard]:
    """Return the tracks that come with the project with their results, by name."""
    return {board.track.name: board for board in read_boards(TRACKS_FOLDER)}


def main() -> None:
    """Compare the documents with the stored results, or mend them."""
    parser = argparse.ArgumentParser(description="Insert figures of the stored results.")
    parser.add_argument("--write", action="store_true", help="mend the documents")
    write = parser.parse_args().write
    logging.getLogger("benchmark").setLevel(logging.ERROR)  # no warnings of missing results
    boards = stored_results()
    wrong = 0
    for path in documents():
        name, text = path.relative_to(ROOT), path.read_text(encoding="utf-8")
        try:
            differing = list(list_stale(boards, text))
        except InputError as error:
            sys.exit(f"error: {name}: {error}")
        for each in differing:
            print(f"{name}: {each}")
        wrong += len(differing)
        if write and differing:
            path.write_text(insert_figures(boards, text), encoding="utf-8")
    if wrong and not write:
        sys.exit("error: figures are stale: python -m experiments.figures --write mends them")


if __name__ == "__main__":
    main()
