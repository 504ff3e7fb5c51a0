"""The command ``submit``, which writes the file of poses that visuallocalization.net scores."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from benchmark.datasets.cmu import Slice, is_cmu, open_slices
from benchmark.datasets.cmu_check import check_files, check_map
from benchmark.evaluation.pose_files import MARK, PoseWriter
from benchmark.evaluation.slice_pairs import Pairs, describe_faults, read_slice_pairs
from benchmark.evaluation.starts import NONE, Start
from objconnect.scene.checks.report import Check, Report
from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.flights.textfiles import read_pairs
from objconnect.scene.localizer import Localizer
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.digests import digest_of
from objconnect.scene.storage.outputs import OutputFile, check_output_folder, check_outputs

SUBMISSION: Final = "submission.txt"
_DECIMALS: Final = 6
# Number of digits of the digest of pairs.
_DIGEST_DIGITS: Final = 12


def submit(
    path: Path,
    localizer: Localizer,
    out: Path,
    *,
    pairs: Path | None = None,
    cache: Path | None = None,
    jobs: int = 1,
) -> tuple[int, int]:
    """Localize every query image of Extended CMU Seasons and write ``OUT/submission.txt``.

    Its lines are ``name qw qx qy qz tx ty tz`` for the images of all slices, with names without a
    folder. The translation is that of the pose from world to camera, although the data set's own
    files hold camera centres. Images that were not localized are left out, as the server requires.
    Finished slices are kept in ``OUT/slices``, so that an interrupted run goes on where it stopped.

    Args:
        path: folder of the data set, or of one of its slices.
        localizer: method to run.
        out: folder of the submission.
        pairs: pair list of hloc, with map photographs for every test image. Query images without a
            pair, which are not test images, are left out. None leaves retrieval to the method.
        cache: folder for data that the method keeps per map; None for a scratch folder in ``out``.
        jobs: number of images at a time, in threads.

    Returns:
        The number of localized images, and the number of images that were to be localized: all
        query images, or those with a pair.

    Raises:
        InputError: a file of the data set is missing, damaged or changed during the run, two
            slices share an image name, the pairs do not fit the slices, or ``out`` cannot be
            written or holds poses of another method, pair list or option.
    """
    slices = open_slices(path)
    finished = _check_outputs(out, path, slices)
    _require_unique_names(slices)
    map_names = {each: _map_names(each) for each in slices}
    pairs_by_query = None
    if pairs is not None:
        pairs_by_query = read_slice_pairs(pairs, map_names)
        slices = [each.restrict(pairs_by_query) for each in slices]
    writer = PoseWriter(localizer, _DECIMALS, cache, jobs)
    starts = [_start_of(each, pairs_by_query) for each in slices]
    for file, start in zip(finished, starts, strict=True):
        writer.require_same_run(file, start)
    lines: list[str] = []
    for each, file, start in zip(slices, finished, starts, strict=True):
        lines += writer.write(each.task(), file, start)
    write_text(out / SUBMISSION, "".join(f"{line}\n" for line in lines))
    return len(lines), sum(len(each.queries) for each in slices)


def check_submission(path: Path, pairs: Path | None = None) -> Report:
    """Check whether all files are there that ``submit`` reads; nothing is written.

    Args:
        path: folder of the data set, or of one of its slices.
        pairs: pair list, or None.

    Raises:
        InputError: the path is not the data set.
    """
    checks = list(check_files(path))
    if is_cmu(path) and all(check.ok or check.name == "slices" for check in checks):
        try:
            _require_unique_names(open_slices(path))
        except InputError as error:
            checks.append(Check("names", False, str(error)))
    if pairs is not None:
        checks += _check_pairs(path, pairs, [check.name for check in checks if not check.ok])
    return Report(str(path), tuple(checks))


def _check_pairs(path: Path, pairs: Path, faults: Sequence[str]) -> list[Check]:
    """Return the checks of a pair list; ``faults`` are the names of failed checks of files."""
    unread = [name for name in faults if name.partition("/")[2] in ("sparse", "query")]
    if unread or not is_cmu(path):
        return [Check("pairs", False, f"not checked: mend {', '.join(unread or faults)} first")]
    try:
        pairs_by_query = read_pairs(pairs)
        map_names = {each: _map_names(each) for each in open_slices(path)}
        sentences = list(describe_faults(pairs, pairs_by_query, map_names))
    except InputError as error:
        sentences = [str(error)]
    if sentences:
        return [Check("pairs", False, sentence) for sentence in sentences]
    total = sum(len(references) for references in pairs_by_query.values())
    return [Check("pairs", True, f"{total} pairs of {len(pairs_by_query)} query images")]


def _check_outputs(out: Path, path: Path, slices: Sequence[Slice]) -> list[Path]:
    """Return the files of finished slices after checking that all files can be written.

    Raises:
        WriteError: a file cannot be written, or another program may have written it.
    """
    check_output_folder(out, [path, *(each.folder for each in slices)])
    finished = [out / "slices" / f"{each.folder.name}.txt" for each in slices]
    check_outputs(
        [*(OutputFile(file, MARK.encode()) for file in finished), out / SUBMISSION], within=out
    )
    started = any(file.is_file() for file in finished)
    if (out / SUBMISSION).exists() and not started:
        # A submission holds only poses, so that its content does not show which program wrote it.
        raise WriteError(
            f"cannot write {out / SUBMISSION}: it exists without the slices of an earlier run, so "
            "another program may have written it: choose another --out"
        )
    return finished


def _require_unique_names(slices: Sequence[Slice]) -> None:
    """Refuse slices that share the name of an image."""
    slice_of: dict[str, Slice] = {}
    for each in slices:
        for name in each.queries:
            if name in slice_of:
                raise InputError(
                    f"{name} is in {slice_of[name].folder} and in {each.folder}: a submission "
                    "does not state the slice of an image, so names must be unique: submit one of "
                    "the slices alone"
                )
            slice_of[name] = each


def _map_names(each: Slice) -> frozenset[str]:
    """Return the names of the map photographs of a slice, all of which exist.

    Raises:
        InputError: the map or a photograph is missing.
    """
    for fault in check_map(each.folder):
        raise InputError(f"{each.folder.parent / fault.name}: {fault.detail}")
    return frozenset(read_model(each.folder / "sparse").names)


def _start_of(each: Slice, pairs: Pairs | None) -> Start:
    """Return the start of a slice, which depends on the pairs of its own query images alone."""
    if pairs is None:
        return NONE
    own = {name: pairs[name] for name in each.queries}
    digest = digest_of(*(" ".join((name, *references)) for name, references in own.items()))
    return Start(f"pairs={digest[:_DIGEST_DIGITS]}", "pairs", pairs=own)
