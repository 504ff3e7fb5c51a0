"""The command ``submission``, which checks a submission to a track and prints its scores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmark.results.results import Results
from benchmark.scoring.score import THRESHOLDS
from benchmark.scoring.summary import Percentage, summarize
from benchmark.submissions.scoring import score_submission
from benchmark.tracks.description import TRACKS_FOLDER


@dataclass(frozen=True)
class SubmissionReport:
    """The scores of a submission.

    Attributes:
        folder: folder of the submission.
        results: results by data set.
    """

    folder: Path
    results: Mapping[str, Results]

    def text(self) -> str:
        """Return one line for each data set, and one for all queries."""
        return "\n".join(
            self._line(name, figures) for name, figures in self.as_dict()["scores"].items()
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the scores for a program."""
        parts = {name: results.queries for name, results in self.results.items()}
        parts["all"] = tuple(query for queries in parts.values() for query in queries)
        scores = {}
        for name, queries in parts.items():
            summary = summarize(queries, unjudged=self._unjudged())
            scores[name] = {
                "queries": summary.queries,
                "poses": summary.queries - summary.failed,
                "recall": {t.key: _percent(summary.recall[t.key]) for t in THRESHOLDS},
                "false_fixes": _percent(summary.false_fixes),
                "wrong_1m": _percent(summary.wrong_1m),
                "worse_than_prior": _percent(summary.worse_than_prior),
            }
        first = next(iter(self.results.values()))
        return {"method": first.method.name, "start": first.start, "scores": scores}

    def _unjudged(self) -> set[str]:
        """Return the thresholds for which reference poses of a data set are too inexact."""
        return {text for results in self.results.values() for text in results.dataset.unjudged}

    def _line(self, name: str, figures: Mapping[str, Any]) -> str:
        recall = ", ".join(
            f"{share:.1f} % within {threshold}"
            for threshold in THRESHOLDS
            if (share := figures["recall"][threshold.key]) is not None
        )
        return f"{name}: {figures['poses']} poses of {figures['queries']} queries; {recall}"


def _percent(share: Percentage | None) -> float | None:
    return None if share is None else round(share.value, 2)


def submission(folder: Path, tracks_folder: Path = TRACKS_FOLDER) -> SubmissionReport:
    """Check and score a submission to a track, without its photographs.

    Args:
        folder: folder with ``card.yaml`` and ``poses/<dataset>.txt``.
        tracks_folder: folder of all tracks.

    Raises:
        InputError: the submission is damaged, of other data than the track's, or a duplicate, or
            the track keeps no reference poses.
    """
    return SubmissionReport(folder, score_submission(folder, tracks_folder))
