"""A submission to a benchmark track: the folder ``<track>/submissions/<name>/``.

It holds ``card.yaml`` and one file of poses for each data set, ``poses/<dataset>.txt``, with hloc's
lines ``name qw qx qy qz tx ty tz`` (world to camera, metres).
"""

from __future__ import annotations

import hashlib
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

from pydantic import AfterValidator, Field

from benchmark.evaluation.starts import parse_start
from objconnect.scene.config import load_config
from objconnect.scene.errors import InputError
from objconnect.scene.flights.textfiles import pose_line, read_poses
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.storage.files import read_text, require_folder
from objconnect.scene.storage.records import Record

SUBMISSIONS: Final = "submissions"
"""The folder of the submissions in the folder of a track."""

CARD: Final = "card.yaml"
_POSES: Final = "poses"
_SUFFIX: Final = ".txt"
# Poses that are equal to this many decimals count as the same.
_DIGEST_DECIMALS: Final = 5
# Largest number of bytes of a card, of a line of a pose file, and of the comments of a pose file.
_CARD_BYTES: Final = 1 << 16
_LINE_BYTES: Final = 1000
_COMMENT_BYTES: Final = 1 << 16
# Letters and marks that fonts draw as nothing (Unicode's Default_Ignorable_Code_Point), and the
# empty pattern of Braille.
_INVISIBLE: Final = re.compile(
    "[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u2800\u3164\ufe00-\ufe0f\uffa0"
    "\U000e0100-\U000e01ef]"
)
_PUNCTUATION: Final = " .,'’&/-"


def _is_visible(words: str) -> str:
    if not words.isprintable() or not words.strip() or _INVISIBLE.search(words):
        raise ValueError("it must be one line of visible characters")
    return words


def _is_list_of_names(words: str) -> str:
    for character in words:
        is_mark = unicodedata.category(character) in ("Mn", "Mc")
        if not (character.isalnum() or is_mark or character in _PUNCTUATION):
            raise ValueError(
                f"it must hold names alone, with {_PUNCTUATION.strip()} between them, and no "
                f"{character!r}"
            )
    return _is_visible(words)


_Line = Annotated[str, Field(max_length=300), AfterValidator(_is_visible)]
_Names = Annotated[str, Field(max_length=300), AfterValidator(_is_list_of_names)]
_Name = Annotated[str, Field(pattern=r"^[a-z0-9]+([-+.][a-z0-9]+)*$", max_length=60)]
_Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class Card(Record):
    """The statements of a submission's authors; only the digests can be verified.

    Attributes:
        track: name of the track.
        method: name of the method on the leaderboard: lower case letters, digits, ``-``, ``+``
            and ``.``.
        authors: who ran it.
        description: what the method is, one line.
        url: address of the code or the paper; None if there is none yet.
        trained_on: data that it was trained on.
        start: information that it had on each query besides the image, one of the track's starts.
        hardware: machine that it ran on, and seconds per query; None if not stated.
        datasets: digest of each data set, all 64 digits, as ``objconnect track --json`` and results
            files show it.
    """

    track: _Line
    method: _Name
    authors: _Names
    description: _Line
    url: Annotated[str, Field(pattern=r"^https?://[^\s<>\"']+$", max_length=300)] | None = None
    trained_on: _Line
    start: _Line
    hardware: _Line | None = None
    datasets: dict[str, _Digest] = Field(min_length=1)


@dataclass(frozen=True)
class Submission:
    """A submission as it was read.

    Attributes:
        folder: its folder.
        card: its card.
        poses: for each data set the poses by name of the query.
        sha256: digest of all poses, whatever the order and the format of the lines.
    """

    folder: Path
    card: Card
    poses: Mapping[str, Mapping[str, Pose]]
    sha256: str


def poses_path(folder: Path, dataset: str) -> Path:
    """Return the file of the poses of a data set in the folder of a submission."""
    return folder / _POSES / f"{dataset}{_SUFFIX}"


def read_card(folder: Path) -> Card:
    """Read the card of a submission.

    Raises:
        InputError: the folder or the card is missing, a link lies there, or the card is wrong.
    """
    require_folder(folder, "submission")
    for path in (folder, *sorted(folder.rglob("*"))):
        if path.is_symlink():
            raise InputError(f"{path} is a link: a submission contains files only")
    if not (folder / CARD).is_file():
        raise InputError(f"{folder} holds no submission: it has no {CARD}")
    _require_small(folder / CARD, _CARD_BYTES, "a card")
    card = load_config(Card, folder / CARD, {})
    parse_start(card.start)
    return card


def read_submission(folder: Path, card: Card, queries: Mapping[str, int]) -> Submission:
    """Read the poses of a submission.

    Args:
        folder: its folder.
        card: its card.
        queries: number of queries of each data set of the card.

    Raises:
        InputError: a file of poses is missing, damaged, empty, larger than its queries need or not
            listed in the card, or the folder holds any other file.
    """
    files = _list_files(folder, card)
    for dataset, path in files.items():
        require_few_lines(path, dataset, queries[dataset])
    poses = {dataset: read_poses(path) for dataset, path in files.items()}
    for dataset, path in files.items():
        if not poses[dataset]:
            raise InputError(f"{path} contains no pose")
    lines = (
        f"{dataset} {pose_line(name, pose, _DIGEST_DECIMALS)}"
        for dataset, dataset_poses in poses.items()
        for name, pose in dataset_poses.items()
    )
    sha256 = hashlib.sha256("\n".join(sorted(lines)).encode()).hexdigest()
    return Submission(folder, card, poses, sha256)


def _list_files(folder: Path, card: Card) -> dict[str, Path]:
    """Return the file of poses of each data set; refuse missing and other files."""
    files = {dataset: poses_path(folder, dataset) for dataset in card.datasets}
    expected = [path.relative_to(folder).as_posix() for path in files.values()]
    found = sorted(
        path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir()
    )
    for name in found:
        if name not in (CARD, *expected):
            raise InputError(
                f"{folder / name} is not a file of this submission: it holds {CARD} and "
                f"{', '.join(expected)}"
            )
    for name in expected:
        if name not in found:
            raise InputError(f"{folder} lacks {name}, whose data set {CARD} lists")
    return files


def _require_small(path: Path, max_bytes: int, what: str) -> None:
    if (size := path.stat().st_size) > max_bytes:
        raise InputError(f"{path} has {size} bytes: {what} has at most {max_bytes}")


def require_few_lines(path: Path, dataset: str, queries: int) -> None:
    """Refuse a file with more poses than queries, before its numbers are parsed, which is slow.

    Args:
        path: file of poses.
        dataset: name of the data set.
        queries: number of its queries.

    Raises:
        InputError: the file has more bytes or lines than the poses of these queries need.
    """
    max_bytes = _COMMENT_BYTES + queries * _LINE_BYTES
    _require_small(path, max_bytes, f"a file of poses of the {queries} queries of {dataset}")
    lines = [line.strip() for line in read_text(path, "pose file").split("\n")]
    poses = sum(bool(line) and not line.startswith("#") for line in lines)
    if poses > queries:
        raise InputError(f"{path} has {poses} poses, but {dataset} has {queries} queries")


def find_submissions(track_folder: Path) -> list[Path]:
    """Return the folders of the submissions to a track, in the order of their names."""
    return sorted(path for path in (track_folder / SUBMISSIONS).glob("*") if path.is_dir())
