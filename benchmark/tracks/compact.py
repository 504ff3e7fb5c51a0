"""Compact results files, because a track stores hundreds of results.

``xz -d`` turns one into an ordinary results file with rounded numbers. Errors (also of priors),
predicted sigmas and NEES keep ten digits, which changes a median or a mean by less than 1e-9 of its
value. If rounding would move a query across a threshold, they keep all digits. Translations are
rounded to 0.1 mm, quaternions to 1e-7 and heights to 1 cm. The seconds of a query keep three
digits, because repeated runs differ by more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from benchmark.results.query_result import QueryResult
from benchmark.results.results import Results, rescore
from benchmark.results.results_files import PACKED, load, method_in, results_files
from benchmark.scoring.summary import summarize, summarize_parts
from benchmark.tracks.description import DESCRIPTION, Track, load_track
from objconnect.scene.errors import InputError
from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.files import require_folder
from objconnect.scene.storage.outputs import check_outputs
from objconnect.scene.storage.packed import XZ_SUFFIX, pack

RESULTS: Final = "results"
"""The folder of a track's results: ``results/<start>/<dataset>/<method>.json.xz``."""

# Significant digits of errors, sigma, NEES and the whole run's figures; and of a query's seconds.
_DIGITS: Final = 10
_TIME_DIGITS: Final = 3
# Decimals of heights (m), quaternions and translations (m).
_HEIGHT_DECIMALS: Final = 2
_QUATERNION_DECIMALS: Final = 7
_TRANSLATION_DECIMALS: Final = 4


def compact(results: Results) -> Results:
    """Return results with rounded numbers, and summaries computed from these."""
    summary = results.summary
    prepare = {"prepare": _round_digits(summary.seconds.prepare, _DIGITS)}
    run_figures = {
        "seconds": summary.seconds.model_copy(update=prepare),
        "peak_memory_mb": _shorten(summary.peak_memory_mb),
    }
    queries = tuple(_round_query(query) for query in results.queries)
    rounded = {"queries": queries, "summary": summary.model_copy(update=run_figures)}
    return rescore(results.model_copy(update=rounded))


def write_compact(path: Path, results: Results) -> None:
    """Write results rounded and compressed, atomically.

    Args:
        path: file to write; its name ends in ``.json.xz``.
        results: results, rounded or not.

    Raises:
        InputError: the folder cannot be written.
    """
    values = compact(results).model_dump(mode="json", by_alias=True)
    figures = {
        key: _shorten(value)
        for key, value in values.items()
        if key == "summary" or key.startswith("by_")
    }
    text = Results.model_validate(values | figures).model_dump_json(by_alias=True)
    with atomic_write(path) as partial:
        partial.write_bytes(pack(text))


def targets_of(results: Sequence[Path], folder: Path) -> dict[Path, Results]:
    """Return the results that ``store`` writes into the folder of a track, by target file.

    Args:
        results: results files, or folders of them.
        folder: folder of the track, with its ``track.yaml``.

    Raises:
        InputError: a file is not a results file, belongs to no data set of the track, has the same
            target as another one, or cannot be written.
    """
    require_folder(folder, "folder of the track")
    if not (folder / DESCRIPTION).exists():
        raise InputError(f"{folder} is not the folder of a track: it has no {DESCRIPTION}")
    track = load_track(folder.resolve().name, folder.resolve().parent)
    files = [file for path in results for file in results_files(path)]
    targets: dict[Path, Results] = {}
    for file in files:
        run = compact(load(file))
        _require_recorded_render(track, run, file)
        method = file.name.removesuffix(XZ_SUFFIX).removesuffix(".json")
        target = folder / RESULTS / run.start / run.dataset.name / f"{method}{PACKED}"
        if targets.get(target, run) != run:
            raise InputError(
                f"{file}: another file has results of {method} on {run.dataset.name} from start "
                f"{run.start}: rename one of the files"
            )
        targets[target] = run
    check_outputs([target for target in targets if target not in files], within=folder)
    for target in targets:
        method_in(target)  # another program's file must not be replaced
    return targets


def store(targets: Mapping[Path, Results]) -> list[Path]:
    """Write results compactly, in place of older ones, and return the files.

    Raises:
        InputError: a folder cannot be written.
    """
    for target, run in targets.items():
        write_compact(target, run)
    return list(targets)


def _require_recorded_render(track: Track, run: Results, file: Path) -> None:
    """Refuse results on a data set or a render of it that the track does not record."""
    (place,) = track.select((run.dataset.name,))
    if run.dataset.sha256 not in place.renders:
        recorded = ", ".join(digest[:12] for digest in place.renders) or "none"
        raise InputError(
            f"{file}: its data set {place.dataset} ({run.dataset.sha256[:12]}) is not a render "
            f"that the track {track.name} records ({recorded}): evaluate on a recorded render, or "
            "record this one by objconnect track --update"
        )


def _round_query(query: QueryResult) -> QueryResult:
    """Return a query with rounded numbers; scores stay exact if rounding changes an outcome."""
    pose = query.cam_from_world
    unscored: dict[str, Any] = {
        "seconds": {stage: _round_digits(s, _TIME_DIGITS) for stage, s in query.seconds.items()},
        "cam_from_world": pose
        and (
            *(round(x, _QUATERNION_DECIMALS) for x in pose[:4]),
            *(round(x, _TRANSLATION_DECIMALS) for x in pose[4:]),
        ),
    }
    scored: dict[str, Any] = {
        key: _shorten(getattr(query, key))
        for key in ("t_err_m", "r_err_deg", "sigma_t_m", "nees", "prior_t_m")
    }
    scored["altitude_m"] = round(query.altitude_m, _HEIGHT_DECIMALS)
    rounded = query.model_copy(update=unscored | scored)
    if _outcomes(rounded) == _outcomes(query):
        return rounded
    return query.model_copy(update=unscored)


def _outcomes(query: QueryResult) -> tuple[object, ...]:
    """Return the figures of a single query, and the name of its altitude band."""
    figures = summarize([query])
    share_inside = figures.uncertainty and figures.uncertainty.within_95.value
    bands = tuple(summarize_parts([query])["altitude"])
    integrity = figures.false_fixes, figures.wrong_1m, figures.worse_than_prior
    return figures.recall, integrity, share_inside, bands


def _shorten(value: Any) -> Any:
    """Return a figure, or figures by name, with ten digits."""
    if isinstance(value, dict):
        return {key: _shorten(inner) for key, inner in value.items()}
    return _round_digits(value, _DIGITS) if isinstance(value, float) else value


def _round_digits(value: float, digits: int) -> float:
    return float(f"{value:.{digits - 1}e}")
