"""The command ``submit``, which writes the file of poses that visuallocalization.net scores."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Final

from benchmark.datasets.cmu import Slice, is_cmu, open_slices
from benchmark.datasets.cmu_check import check_files, check_map
from benchmark.evaluation.slice_pairs import Pairs, describe_faults, read_slice_pairs
from objconnect.localization.pipeline.failures import localize_safely
from objconnect.localization.pipeline.journal import Journal, journal_path
from objconnect.scene.checks.report import Check, Report
from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.flights.textfiles import pose_line, read_pairs
from objconnect.scene.localizer import Estimate, Localizer, Query, Status
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.runtime.threads import map_unordered
from objconnect.scene.storage.answers import NamedRecord, PoseNumbers, pose_of
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.digests import digest_of, digests
from objconnect.scene.storage.files import read_text
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.outputs import OutputFile, check_output_folder, check_outputs
from objconnect.scene.storage.scratch import cache_or_scratch

SUBMISSION: Final = "submission.txt"
_DECIMALS: Final = 6
# The first bytes of the file of a finished slice.
_HEADER_START: Final = b"# finished by objconnect: "


class _Answer(NamedRecord):
    """The pose of a query image, world to camera; None if the image was not localized."""

    cam_from_world: PoseNumbers | None

    @staticmethod
    def of(name: str, estimate: Estimate) -> _Answer:
        """Return the entry of an estimate; a fallback is not a localized image."""
        pose = estimate.cam_from_world
        if estimate.status is not Status.OK or pose is None:
            return _Answer(name=name, cam_from_world=None)
        numbers = (*pose.quaternion().tolist(), *pose.translation.tolist())
        return _Answer(name=name, cam_from_world=numbers)


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
    Finished slices are kept in ``OUT/slices``, and the finished images of an unfinished slice in a
    journal beside them, so that an interrupted run goes on where it stopped.

    Args:
        path: folder of the data set, or of one of its slices.
        localizer: method to run.
        out: folder of the submission.
        pairs: pair list of hloc, with map photographs for every test image. Query images without a
            pair, which are not test images, are left out. None leaves retrieval to the method.
        cache: folder for what the method keeps per map; None for a scratch folder in ``out``.
        jobs: number of images at a time, in threads.

    Returns:
        The number of localized images, and the number of all images.

    Raises:
        InputError: a file of the data set is missing or damaged, two slices share an image name,
            the pairs do not fit the slices, or ``out`` cannot be written.
    """
    slices = open_slices(path)
    finished = _check_outputs(out, path, slices)
    _require_unique_names(slices)
    map_names = {each: _map_names(each) for each in slices}
    listed = None
    if pairs is not None:
        listed = read_slice_pairs(pairs, map_names)
        slices = [each.restrict(listed) for each in slices]
    lines: list[str] = []
    for each, file in zip(slices, finished, strict=True):
        lines += _finish_slice(each, localizer, listed, file, cache, jobs)
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
        listed = read_pairs(pairs)
        map_names = {each: _map_names(each) for each in open_slices(path)}
        sentences = list(describe_faults(pairs, listed, map_names))
    except InputError as error:
        sentences = [str(error)]
    if sentences:
        return [Check("pairs", False, sentence) for sentence in sentences]
    total = sum(len(references) for references in listed.values())
    return [Check("pairs", True, f"{total} pairs of {len(listed)} query images")]


def _check_outputs(out: Path, path: Path, slices: Sequence[Slice]) -> list[Path]:
    """Return the files of finished slices after checking that all files can be written.

    Raises:
        WriteError: a file cannot be written, or another program may have written it.
    """
    check_output_folder(out, [path, *(each.folder for each in slices)])
    finished = [out / "slices" / f"{each.folder.name}.txt" for each in slices]
    check_outputs(
        [*(OutputFile(file, _HEADER_START) for file in finished), out / SUBMISSION], within=out
    )
    started = any(file.is_file() for file in finished)
    if (out / SUBMISSION).exists() and not started:
        # A submission holds only poses, so nothing in it tells which program wrote it.
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


def _finish_slice(
    each: Slice,
    localizer: Localizer,
    pairs: Pairs | None,
    file: Path,
    cache: Path | None,
    jobs: int,
) -> list[str]:
    """Return the pose lines of one slice; a finished slice is read from ``file``."""
    key = _key(each, localizer, pairs)
    header = f"{_HEADER_START.decode()}{key}"
    if file.is_file():
        first, *lines = read_text(file, "finished slice").splitlines() or [""]
        if first == header:
            return lines
    with Journal(journal_path(file), key, _Answer) as journal:
        _localize_slice(each, localizer, pairs, journal, cache, jobs)
        poses = {name: journal.done[name].cam_from_world for name in each.queries}
        lines = [
            pose_line(name, pose_of(pose), _DECIMALS)
            for name, pose in poses.items()
            if pose is not None
        ]
        write_text(file, "".join(f"{line}\n" for line in [header, *lines]))
    return lines


def _key(each: Slice, localizer: Localizer, pairs: Pairs | None) -> str:
    """Return the digest of everything that determines the poses of a slice."""
    folder = each.folder
    sparse_map = read_model(folder / "sparse")
    words = [localizer.name, localizer.config.model_dump_json(), str(localizer.weights_sha256)]
    words += [sparse_map.sha256, *digests(folder / "database" / n for n in sparse_map.names)]
    words += [f"{name} {each.camera(name)}" for name in each.queries]
    words += digests(folder / "query" / name for name in each.queries)
    if pairs is not None:
        words += [" ".join((name, *pairs[name])) for name in each.queries]
    return digest_of(*words)


def _localize_slice(
    each: Slice,
    localizer: Localizer,
    pairs: Pairs | None,
    journal: Journal[_Answer],
    cache: Path | None,
    jobs: int,
) -> None:
    """Localize the query images of a slice that are not in the journal, and add them to it."""

    def localize(name: str) -> None:
        camera = each.camera(name)
        image = read_rgb(each.folder / "query" / name, camera)
        references = None if pairs is None else pairs[name]
        estimate = localize_safely(localizer, Query(name, image, camera, references=references))
        journal.add(_Answer.of(name, estimate))

    waiting = [name for name in each.queries if name not in journal.done]
    if not waiting:
        return
    with cache_or_scratch(cache, journal.path.parent) as folder:
        localizer.prepare(read_model(each.folder / "sparse"), each.folder / "database", folder)
    with (
        progress_bar(f"{each.folder.name} {localizer.name}", len(each.queries)) as advance,
        closing(map_unordered(localize, waiting, jobs)) as localized,
    ):
        advance(len(journal.done))
        for _ in localized:
            advance(len(journal.done))
