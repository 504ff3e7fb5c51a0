"""Scoring of submissions against the reference poses that a track keeps.

A track stores the poses of all photographs of each rendered scene, so that no scene has to be
rendered again. The poses are rounded to micrometres, which changes no score.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import torch

from benchmark.evaluation.scored_query import QueryFacts, score_estimate
from benchmark.evaluation.starts import parse_start
from benchmark.results.query_result import QueryResult
from benchmark.results.results import Results
from benchmark.results.results_files import load
from benchmark.submissions.submission import (
    Card,
    Submission,
    find_submissions,
    read_card,
    read_submission,
)
from benchmark.tracks.compact import RESULTS
from benchmark.tracks.description import Track, load_track
from benchmark.tracks.renders import read_render, render_path
from objconnect.localization.provenance import Method
from objconnect.methods import method_names
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Status

# Names of the methods of the object-connect paper that no method of the project has.
_PAPER_METHODS: Final = ("d2-net", "object-connect")


@dataclass(frozen=True)
class ScoredSubmission:
    """A submission with its results by data set."""

    submission: Submission
    results: Mapping[str, Results]


def read_submissions(track: Track, tracks_folder: Path) -> tuple[list[ScoredSubmission], list[str]]:
    """Read and score the submissions that a track keeps.

    Returns:
        The submissions, and a sentence for each folder that is left out because it is damaged, for
        another track, or a duplicate.
    """
    scored: list[ScoredSubmission] = []
    left_out = []
    for folder in find_submissions(tracks_folder / track.name):
        try:
            submission = _read(folder, track, tracks_folder)
            _refuse_duplicates(submission, [one.submission for one in scored])
            results = _score_all(submission, tracks_folder / track.name)
        except InputError as error:
            left_out.append(f"the submission {folder.name} is left out: {error}")
            continue
        scored.append(ScoredSubmission(submission, results))
    return scored, left_out


def score_submission(folder: Path, tracks_folder: Path) -> dict[str, Results]:
    """Check and score a submission.

    Args:
        folder: folder of the submission; it need not lie in the folder of its track.
        tracks_folder: folder of all tracks.

    Returns:
        The results by data set.

    Raises:
        InputError: the submission is damaged, of other data than the track's, or a duplicate, or
            the track keeps no reference poses.
    """
    track = load_track(read_card(folder).track, tracks_folder)
    submission = _read(folder, track, tracks_folder)
    others = []
    for other in find_submissions(tracks_folder / track.name):
        if other.resolve() != folder.resolve():
            # Damage of another folder is not a fault of this one.
            with suppress(InputError):
                others.append(_read(other, track, tracks_folder))
    _refuse_duplicates(submission, others)
    return _score_all(submission, tracks_folder / track.name)


def _read(folder: Path, track: Track, tracks_folder: Path) -> Submission:
    """Read a submission to a track, whose card is checked before its poses are read."""
    card = read_card(folder)
    _check(card, folder, track)
    queries = {
        dataset: len(_any_results(tracks_folder / track.name, dataset).queries)
        for dataset in card.datasets
    }
    return read_submission(folder, card, queries)


def _score_all(submission: Submission, track_folder: Path) -> dict[str, Results]:
    """Score a submission that was checked; return the results by data set."""
    return {
        dataset: _score(submission, dataset, poses, track_folder)
        for dataset, poses in submission.poses.items()
    }


def _check(card: Card, folder: Path, track: Track) -> None:
    """Refuse a card of other data, from a start that the track lacks, or with a taken name."""
    if card.track != track.name:
        raise InputError(f"{folder}: the card names the track {card.track!r}, not {track.name!r}")
    if card.start not in track.starts:
        raise InputError(
            f"{folder}: the track {track.name} has no start {card.start!r}; it has "
            f"{', '.join(track.starts)}"
        )
    if card.method in (*track.methods, *method_names(), *_PAPER_METHODS):
        raise InputError(
            f"{folder}: {card.method} is the name of a method of the project or of the paper: "
            "choose another name"
        )
    try:
        places = track.select(tuple(card.datasets))
    except InputError as error:
        raise InputError(f"{folder}: {error}") from None
    for place in places:
        if (digest := card.datasets[place.dataset]) not in place.renders:
            recorded = ", ".join(each[:12] for each in place.renders) or "none"
            raise InputError(
                f"{folder}: its {place.dataset} is data set {digest[:12]}, not one that the track "
                f"{track.name} records ({recorded}): use a recorded render or a published copy"
            )


def _refuse_duplicates(submission: Submission, others: Sequence[Submission]) -> None:
    """Refuse the name or the poses of another submission."""
    card, folder = submission.card, submission.folder
    for other in others:
        is_theirs = (card.method, card.authors) == (other.card.method, other.card.authors)
        if card.method == other.card.method and not is_theirs:
            raise InputError(
                f"{folder}: {card.method} is a method of {other.card.authors}: choose another name"
            )
        if submission.sha256 == other.sha256 and not is_theirs:
            raise InputError(f"{folder}: {other.folder} has the same poses")
        if (card.method, card.start) == (other.card.method, other.card.start):
            raise InputError(
                f"{folder}: {other.folder} has results of {card.method} from start {card.start}: "
                "choose another name, or replace that submission"
            )


def _score(
    submission: Submission, dataset: str, poses: Mapping[str, Pose], track_folder: Path
) -> Results:
    stored = _any_results(track_folder, dataset)
    references = _reference_poses(track_folder, dataset)
    known = {query.name for query in stored.queries}
    for name in poses:
        if name not in known:
            raise InputError(
                f"{submission.folder}: {name} is not a query of {dataset}; names are those of the "
                "photographs in the scene, such as " + min(known)
            )
    queries = [
        _score_query(query, references[query.name], poses.get(query.name))
        for query in stored.queries
    ]
    method = Method.external(submission.card.method, submission.sha256)
    identity = stored.dataset.model_copy(update={"sha256": submission.card.datasets[dataset]})
    return Results.of(method, identity, parse_start(submission.card.start).name, queries)


def _score_query(query: QueryResult, reference: Pose, pose: Pose | None) -> QueryResult:
    """Return the result of a query for a pose of a submission.

    The facts of the query come from the result of another method. Its prior is left out, because
    that result may be from another start.
    """
    facts = QueryFacts(*(getattr(query, name) for name in QueryFacts._fields))
    facts = facts._replace(prior_t_m=None)
    if pose is None:
        estimate = Estimate(Status.FAILED, reason="no line in the submission")
    else:
        estimate = Estimate(Status.OK, pose)
    return score_estimate(facts, reference, estimate)


def _any_results(track_folder: Path, dataset: str) -> Results:
    """Return any stored results of a data set, which hold the facts of its queries."""
    files = sorted((track_folder / RESULTS).glob(f"*/{dataset}/*.json*"))
    if not files:
        raise InputError(
            f"{track_folder} keeps no results of {dataset} yet: submissions to it cannot be scored"
        )
    return load(files[0])


def _reference_poses(track_folder: Path, dataset: str) -> dict[str, Pose]:
    """Return cam_from_world of all photographs of a data set by name."""
    record = render_path(track_folder, dataset)
    if not os.path.lexists(record):
        raise InputError(
            f"{record} is missing: the track keeps no reference poses of {dataset}, so only its "
            "owners can score poses, by objconnect score"
        )
    poses = {}
    for frame in read_render(record).frames:
        rows = torch.tensor(frame.cam_from_world, dtype=torch.float64).reshape(3, 4)
        poses[frame.name] = Pose(rows[:, :3], rows[:, 3])
    return poses
