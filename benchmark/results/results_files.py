"""Finding, checking and reading of results files."""

from __future__ import annotations

import math
from collections.abc import Set
from pathlib import Path
from typing import Final

from benchmark.results.results import Results, rescore
from benchmark.scoring.score import THRESHOLDS
from benchmark.scoring.summary import PARTS
from objconnect.localization.provenance import Method
from objconnect.scene.bundle.manifest import read_json
from objconnect.scene.errors import InputError
from objconnect.scene.localizer import Status
from objconnect.scene.storage.files import parse_json
from objconnect.scene.storage.listing import list_files
from objconnect.scene.storage.outputs import check_outputs, foreign_file_error
from objconnect.scene.storage.packed import XZ_MAGIC, XZ_SUFFIX, unpack

# Ending of files of basins of convergence (``evaluation.basin``), which lie beside results.
BASIN: Final = ".basin.json"

# Ending of compact results files; see ``benchmark.tracks.compact``.
PACKED: Final = f".json{XZ_SUFFIX}"

# The first bytes of every results file and basin file; of a compact one, after unpacking.
_HEADS: Final = (b'{\n "schema": 1,\n "method": {', b'{"schema":1,"method":{')

# Largest relative difference of stored and recomputed figures; a larger one means that the file was
# changed.
_TOLERANCE = 1e-9
# Figures that files of earlier versions lack; they are computed on reading.
_ADDED: Final = {
    "courses",
    "false_fixes",
    "wrong_1m",
    "worse_than_prior",
    "nees_low",
    "nees_high",
}
# Figures in files of earlier versions that the reference poses may be too inexact to judge.
_UNJUDGED: Final = {"false_fixes", *(threshold.key for threshold in THRESHOLDS)}
# Bounds of intervals. In files without courses they assume independent queries and are replaced.
_ENDS: Final = {"low", "high"}


def method_in(path: Path) -> Method | None:
    """Return the method of the results file or basin file at a path.

    The answer is None for no file, or for a damaged one that this program wrote.

    Raises:
        WriteError: the file is of another kind.
    """
    if not path.is_file():
        return None
    content = path.read_bytes()
    if content.startswith(XZ_MAGIC):
        try:
            content = unpack(content)
        except ValueError:
            return None
    try:
        return Method.model_validate(parse_json(content.decode())["method"])
    except (ValueError, KeyError, TypeError):
        if content and not content.startswith(_HEADS):
            raise foreign_file_error(path) from None
    return None


def check_results_output(path: Path, method: Method, out: Path) -> None:
    """Refuse to replace a file that is not an older version of these results.

    Results of ``evaluate`` are replaced only by ``evaluate``, and those of ``score`` by ``score``.

    Args:
        path: path of the results that will be written.
        method: their method.
        out: folder of all results.

    Raises:
        InputError: another command wrote the file there, or ``check_outputs`` refuses
            the path.
    """
    check_outputs([path], within=out)
    before = method_in(path)
    if before is None:
        return
    if before.is_external != method.is_external:
        writer = "score" if before.is_external else "evaluate"
        remedy = "remove it" if before.is_external else "choose another --method"
        raise InputError(
            f"{path} holds results that {writer} wrote: {remedy}, or choose another --out"
        )


def results_files(path: Path) -> list[Path]:
    """Return the results files in a folder ``RESULTS`` or ``RESULTS/<dataset>``, or the one file.

    Raises:
        InputError: there is no results file.
    """
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise InputError(f"results {path} do not exist: give a file or folder that evaluate wrote")
    files = [
        file
        for file in list_files(path, (".json", XZ_SUFFIX), depth=2)
        if file.name.lower().endswith((".json", PACKED)) and not file.name.endswith(BASIN)
    ]
    if not files:
        raise InputError(f"{path} holds no results file (<dataset>/<method>.json)")
    return files


def load(path: Path) -> Results:
    """Read a results file and recompute its figures.

    Raises:
        InputError: the file cannot be read or is not a results file, a query contradicts itself, or
            the summaries do not match the per-query results.
    """
    results = read_json(path, Results, "results file")
    seen: set[str] = set()
    for query in results.queries:
        if query.name in seen:
            raise InputError(f"results file {path}: query {query.name} is listed twice")
        seen.add(query.name)
        missing = {query.cam_from_world is None, query.t_err_m is None, query.r_err_deg is None}
        if missing != {query.status is Status.FAILED}:
            raise InputError(
                f"results file {path}: query {query.name} has status '{query.status}', which "
                "contradicts its pose and errors; evaluate again"
            )
    recomputed = rescore(results)
    parts = {"summary", *(f"by_{part}" for part in PARTS)}
    stored, computed = (each.model_dump(include=parts) for each in (results, recomputed))
    replaced = _ENDS if any(query.course is None for query in results.queries) else set()
    for part in stored:
        if (where := _difference(stored[part], computed[part], part, replaced)) is not None:
            raise InputError(
                f"results file {path}: {where} does not match its per-query results; "
                "the file was changed after it was written; evaluate again"
            )
    return recomputed


def _difference(stored: object, computed: object, where: str, replaced: Set[str]) -> str | None:
    """Return the dotted name of the first figure that differs and is not replaced, or None."""
    if isinstance(stored, dict) and isinstance(computed, dict):
        for key in sorted(stored.keys() | computed.keys()):
            if key in replaced or (key in _ADDED and stored.get(key) is None):
                continue
            if key in _UNJUDGED and computed.get(key) is None:
                continue
            if key not in stored or key not in computed:
                return f"{where}.{key}"
            difference = _difference(stored[key], computed[key], f"{where}.{key}", replaced)
            if difference is not None:
                return difference
        return None
    if isinstance(stored, float) and isinstance(computed, float):
        return None if math.isclose(stored, computed, rel_tol=_TOLERANCE) else where
    return None if stored == computed else where
