"""Checks of a download of Extended CMU Seasons: which files are missing, and what to do."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from benchmark.datasets.cmu import (
    INTRINSICS,
    list_queries,
    read_intrinsics,
    read_references,
    read_test_list,
    root_of,
    slice_folders,
)
from objconnect.scene.checks.report import Check
from objconnect.scene.errors import InputError
from objconnect.scene.exports.cmu_names import SIMULATED_HEADER, ImageName
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.storage.files import read_text
from objconnect.scene.storage.names import name_some

DOWNLOAD: Final = (
    "https://data.ciirc.cvut.cz/public/projects/2020VisualLocalization/Extended-CMU-Seasons/"
)
"""Folder of the files, to which visuallocalization.net links."""

# The slices that hloc and PixLoc localize for visuallocalization.net.
_SUBMITTED_SLICES: Final = (*range(2, 7), *range(13, 22))


def check_files(path: Path) -> Iterator[Check]:
    """Yield a check for each slice that is complete, and for everything that is missing or wrong.

    Photographs must exist and must not be empty; they are not decoded.

    Args:
        path: folder of the data set, or of one of its slices.

    Raises:
        InputError: the path is not a folder, or there is neither ``intrinsics.txt`` nor a slice.
    """
    if not path.is_dir():
        raise InputError(f"{path} is not Extended CMU Seasons: it is not a folder; check the path")
    root = root_of(path)
    folders = slice_folders(path)
    archives = sorted(root.glob("slice*.tar"))
    if not folders and not archives and not (root / INTRINSICS).is_file():
        raise InputError(
            f"{path} is not Extended CMU Seasons, nor a slice of it: it has neither {INTRINSICS} "
            "nor folders slice2, slice3 and so on"
        )
    yield from _check_intrinsics(root)
    if root == path.resolve():
        yield from _check_slices(root, folders, archives)
    for folder in folders:
        faults = list(_check_slice(folder))
        yield from faults or (_describe_slice(folder),)


def check_map(folder: Path) -> Iterator[Check]:
    """Yield a failed check if the map of a slice, or a photograph of its map, is missing."""
    try:
        names = read_model(folder / "sparse").names
    except InputError as error:
        yield _fault(folder, "sparse", f"{error}; {_advise_unpacking(folder)}")
        return
    missing = [name for name in names if not _has_bytes(folder / "database" / name)]
    if missing:
        yield _fault(
            folder,
            "database",
            f"{len(missing)} of {len(names)} map photographs are missing or empty "
            f"({name_some(missing)}): {_advise_unpacking(folder)}",
        )


def _check_intrinsics(root: Path) -> Iterator[Check]:
    """Yield a failed check if the file of the cameras is missing or wrong."""
    if not (root / INTRINSICS).is_file():
        yield Check(INTRINSICS, False, f"missing: download {DOWNLOAD}{INTRINSICS} into {root}")
        return
    try:
        read_intrinsics(root)
    except InputError as error:
        yield Check(INTRINSICS, False, f"{error}; download {DOWNLOAD}{INTRINSICS} again")


def _check_slices(root: Path, folders: list[Path], archives: list[Path]) -> Iterator[Check]:
    """Yield failed checks for archives that are not unpacked, and for slices that are missing."""
    present = {folder.name for folder in folders}
    packed = [archive for archive in archives if archive.stem not in present]
    for archive in packed:
        yield Check(archive.name, False, f"not unpacked: run tar -xf {archive.name} in {root}")
    present |= {archive.stem for archive in packed}
    absent = [f"slice{n}" for n in _SUBMITTED_SLICES if f"slice{n}" not in present]
    if absent and not (folders and _is_simulated(root)):
        yield Check(
            "slices",
            False,
            f"{', '.join(absent)} missing: download {DOWNLOAD}{absent[0]}.tar and so on, or submit "
            "without them",
        )


def _check_slice(folder: Path) -> Iterator[Check]:
    """Yield the failed checks of a slice."""
    yield from check_map(folder)
    photographs = list_queries(folder)
    if not photographs:
        yield _fault(folder, "query", f"no photograph: {_advise_unpacking(folder)}")
    strange = [name for name in photographs if not ImageName.matches(name)]
    if strange:
        yield _fault(
            folder,
            "query",
            f"{name_some(strange)} not named like img_00119_c0_1303398474779439us.jpg: move these "
            "files elsewhere",
        )
    empty = [name for name in photographs if not _has_bytes(folder / "query" / name)]
    if empty:
        yield _fault(folder, "query", f"{name_some(empty)} empty: {_advise_unpacking(folder)}")
    yield from _check_lists(folder, photographs)


def _check_lists(folder: Path, photographs: Iterable[str]) -> Iterator[Check]:
    """Yield failed checks if the lists of a slice are missing, or name missing photographs."""
    listed_names: set[str] = set()
    for part, read in (("camera-poses", _list_public_poses), ("test list", read_test_list)):
        try:
            listed_names |= read(folder)
        except InputError as error:
            yield _fault(folder, part, f"{error}; {_advise_unpacking(folder)}")
    missing = sorted(listed_names.difference(photographs))
    if missing:
        yield _fault(
            folder,
            "query",
            f"{len(missing)} listed photographs are missing ({name_some(missing)}): "
            f"{_advise_unpacking(folder)}",
        )


def _describe_slice(folder: Path) -> Check:
    """Return the passed check of a complete slice."""
    map_photographs, queries = len(read_model(folder / "sparse").names), len(list_queries(folder))
    public = len(_list_public_poses(folder))
    return Check(
        folder.name,
        True,
        f"{map_photographs} map photographs, {queries} query images, {public} public query poses",
    )


def _list_public_poses(folder: Path) -> set[str]:
    """Return the names of the photographs of a slice with a public pose."""
    poses = folder / "camera-poses"
    if not poses.is_dir():
        raise InputError("missing")
    return set(read_references(poses))


def _fault(folder: Path, part: str, detail: str) -> Check:
    return Check(f"{folder.name}/{part}", False, detail)


def _advise_unpacking(folder: Path) -> str:
    return f"unpack {folder.name}.tar again"


def _has_bytes(path: Path) -> bool:
    return path.is_file() and path.stat().st_size > 0


def _is_simulated(root: Path) -> bool:
    intrinsics = root / INTRINSICS
    return intrinsics.is_file() and read_text(intrinsics, "cameras").startswith(SIMULATED_HEADER)
