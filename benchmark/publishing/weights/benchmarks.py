"""Scores on published data sets, as the hub's leaderboards read them.

The hub reads ``.eval_results/*.yaml`` of a model repository: a list of scores, each with the data
set's repository, task and commit (https://huggingface.co/docs/hub/eval-results). The task is the
prior that the method received (``--start``), such as ``none``, because only methods with the same
prior are compared.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import yaml

from benchmark.publishing.index import INDEX, read_index
from benchmark.publishing.weights.evaluations import Evaluation
from benchmark.results.results import Results
from benchmark.scoring.score import THRESHOLDS
from benchmark.scoring.summary import summarize
from objconnect.scene.errors import InputError
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.hub import download, is_address, parse_address

FOLDER: Final = ".eval_results"

_THRESHOLD: Final = THRESHOLDS[1]
_DECIMALS: Final = 2


@dataclass(frozen=True)
class Benchmark:
    """A published data set on the hub.

    Attributes:
        repository: its repository, OWNER/NAME.
        commit: commit of the repository.
        scenes: digests of its scenes.
    """

    repository: str
    commit: str
    scenes: frozenset[str]


def open_benchmark(address: Path) -> Benchmark:
    """Read which scenes a published data set on the hub has; nothing else is downloaded.

    Raises:
        InputError: the address names no commit or cannot be read, or is not a published data set.
    """
    if not is_address(address):
        raise InputError(
            f"benchmark {str(address)!r} is not on the hub: write hf://OWNER/NAME@COMMIT"
        )
    repository, commit = parse_address(address, "dataset")
    published = read_index(download(address, "dataset", include=[INDEX]))
    return Benchmark(repository, commit, frozenset(scene.sha256 for scene in published.scenes))


def scores(
    benchmark: Benchmark, evaluations: Sequence[Evaluation]
) -> dict[str, list[dict[str, Any]]]:
    """Return the scores on a published data set by the name of their file.

    A score is the recall within 0.5 m and 5° in percent over all scenes of the data set. Results
    whose reference poses are too inexact for this threshold are left out.

    Raises:
        InputError: no method has usable results of all scenes with the same prior.
    """
    runs: dict[tuple[str, str], dict[str, Results]] = {}
    for each in evaluations:
        run = each.results
        is_judged = str(_THRESHOLD) not in run.dataset.unjudged
        if is_judged and run.dataset.sha256 in benchmark.scenes:
            runs.setdefault((run.method.name, run.start), {})[run.dataset.sha256] = run
    files: dict[str, list[dict[str, Any]]] = {}
    for (method, start), by_scene in runs.items():
        if by_scene.keys() == benchmark.scenes:
            name = _slug(f"{benchmark.repository.rpartition('/')[2]}-{method}")
            files.setdefault(f"{name}.yaml", []).append(_score(benchmark, method, start, by_scene))
    if not files:
        raise InputError(
            f"{benchmark.repository}: no method has results of all its {len(benchmark.scenes)} "
            "scenes with the same --start: evaluate the whole data set"
        )
    return files


def write_scores(folder: Path, files: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    """Write the scores into a model repository.

    Raises:
        InputError: a file cannot be written.
    """
    for name, entries in files.items():
        path = folder / FOLDER / name
        path.parent.mkdir(exist_ok=True)
        write_text(path, yaml.safe_dump(list(entries), sort_keys=False, allow_unicode=True))


def _score(
    benchmark: Benchmark, method: str, start: str, by_scene: Mapping[str, Results]
) -> dict[str, Any]:
    queries = [query for run in by_scene.values() for query in run.queries]
    recall = summarize(queries, 0.0, None).recall[_THRESHOLD.key]
    assert recall is not None  # ``scores`` leaves out runs with too inexact poses
    return {
        "dataset": {
            "id": benchmark.repository,
            "task_id": _slug(start),
            "revision": benchmark.commit,
        },
        "value": round(recall.value, _DECIMALS),
        "notes": f"{method} from start {start}: recall within {_THRESHOLD} in %, "
        f"{len(queries)} queries",
    }


def _slug(text: str) -> str:
    """Return a text with hyphens in place of all but letters, digits and dots.

    Examples:
        >>> _slug("error=3m,5deg")
        'error-3m-5deg'
    """
    return re.sub(r"[^A-Za-z0-9.]+", "-", text).strip("-")
