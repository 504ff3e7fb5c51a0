"""Small photographs of the queries that most methods get wrong, stored with a track.

``<track>/album/<dataset>.h5`` is an album (``benchmark.report.album``) of a few queries with small
photographs. This command makes it from the albums that ``evaluate`` writes beside results:
``python -m benchmark.report.board.pictures --track benchmark/tracks/uav-seasons RESULTS...``
"""

from __future__ import annotations

import argparse
import base64
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from benchmark.report.album import ALBUM, Album, read_album, write_album
from benchmark.report.board.runs import TrackBoard, read_board
from benchmark.report.page import PICTURE_BYTES, shrink
from objconnect.scene.errors import InputError
from objconnect.scene.storage.outputs import check_outputs

_FOLDER: Final = "album"
# Queries of each data set, and the longest side of their photographs, pixels. Ten data sets take
# about a megabyte.
_QUERIES: Final = 12
_SIDE: Final = 160
# Threshold by which the queries are chosen: 0.5 m 5°.
_THRESHOLD: Final = 1


class Pictures:
    """The photographs of a page, up to a total size.

    Attributes:
        encoded: photographs as data URLs.
    """

    def __init__(self) -> None:
        self.encoded: list[str] = []
        self._bytes_left = PICTURE_BYTES

    def add_track(self, board: TrackBoard) -> dict[int, list[int | None]]:
        """Add the stored photographs of a track, and return their indices in ``encoded``.

        The indices are those of the photographs of query and map, by the index of the query. A
        photograph that no longer fits is None.

        Raises:
            InputError: an album is damaged.
        """
        numbers: dict[int, list[int | None]] = {}
        for place in board.track.places:
            path = board.folder / _FOLDER / f"{place.dataset}.h5"
            if (album := read_album(path, *place.renders)) is None:
                continue
            for k, query in enumerate(board.queries):
                if query.dataset == place.dataset and query.row.name in album.entries:
                    entry = album.entries[query.row.name]
                    numbers[k] = [self._add(entry.photograph)]
                    if entry.neighbour is not None:
                        numbers[k].append(self._add(album.neighbours[entry.neighbour].photograph))
        return numbers

    def _add(self, photograph: bytes) -> int | None:
        text = "data:image/webp;base64," + base64.b64encode(photograph).decode()
        if len(text) > self._bytes_left:
            return None
        self._bytes_left -= len(text)
        self.encoded.append(text)
        return len(self.encoded) - 1


def keep_pictures(results: Sequence[Path], track: Path) -> list[Path]:
    """Store small photographs of the queries of a track that most runs get wrong.

    Args:
        results: folders that ``evaluate`` wrote, with albums of the track's data sets.
        track: folder of the track, with its stored results.

    Returns:
        The albums that were written.

    Raises:
        InputError: the track cannot be read, an album is damaged or cannot be written, or no album
            belongs to the track's data.
    """
    board = read_board(track.resolve().name, track.resolve().parent)
    written = []
    for place in board.track.places:
        names = _hardest_queries(board, place.dataset)
        for folder in results if names else ():
            album = read_album(folder / place.dataset / ALBUM, *place.renders)
            if album:
                target = track / _FOLDER / f"{place.dataset}.h5"
                check_outputs([target], results, within=track)
                write_album(target, _shrink_album(album, names))
                written.append(target)
                break
    if not written:
        raise InputError(
            f"no {ALBUM} in {', '.join(map(str, results))} belongs to the data of {track}: give "
            "folders that evaluate wrote on these data sets"
        )
    return written


def _hardest_queries(board: TrackBoard, dataset: str) -> list[str]:
    """Return the queries of a data set that most runs get wrong at 0.5 m 5°, most first."""
    wrong = {
        query.row.name: sum(
            int(run.has[k] and not run.correct[_THRESHOLD, k]) for run in board.runs
        )
        for k, query in enumerate(board.queries)
        if query.dataset == dataset
    }
    return sorted((name for name in wrong if wrong[name]), key=lambda name: -wrong[name])[:_QUERIES]


def _shrink_album(album: Album, names: Sequence[str]) -> Album:
    """Return the album of these queries alone, with small photographs and without points."""
    entries = {name: album.entries[name] for name in names if name in album.entries}
    neighbours = {entry.neighbour for entry in entries.values() if entry.neighbour is not None}
    return Album(
        album.sha256,
        {
            name: replace(
                entry,
                photograph=shrink(entry.photograph, _SIDE),
                world=entry.world[:0],
                truth=entry.truth[:0],
                seen=entry.seen[:0],
            )
            for name, entry in entries.items()
        },
        {
            name: replace(
                album.neighbours[name], photograph=shrink(album.neighbours[name].photograph, _SIDE)
            )
            for name in sorted(neighbours)
        },
    )


def main(words: Sequence[str] | None = None) -> int:
    """Run ``keep_pictures`` from the command line and return the exit code."""
    parser = argparse.ArgumentParser(description="Keep small photographs of the hardest queries.")
    parser.add_argument("--track", type=Path, required=True)
    parser.add_argument("results", type=Path, nargs="+")
    arguments: Any = parser.parse_args(words)
    try:
        for path in keep_pictures(arguments.results, arguments.track):
            print(path)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
