"""Matching of photographs with the names in another program's file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath
from typing import Final

from objconnect.scene.errors import InputError

_Normalization = Callable[[str], str]


def _fold_case(name: str) -> str:
    return name.replace("\\", "/").casefold()


# Compared forms, strict to loose: path; file name; both ignoring case and with "\" as "/"; stem.
_NORMALIZATIONS: Final[tuple[_Normalization, ...]] = (
    lambda name: name,
    lambda name: PurePosixPath(name).name,
    _fold_case,
    lambda name: PurePosixPath(_fold_case(name)).name,
    lambda name: PurePosixPath(_fold_case(name)).stem,
)


def match_files(files: Sequence[str], names: Sequence[str], where: Path) -> dict[str, str]:
    """Return each photograph's name in the file; photographs without one are omitted.

    Paths are compared first, then file names, then both ignoring case, then file names without
    suffix, which Metashape's labels lack. A name that matches strictly takes no part in looser
    comparisons.

    Args:
        files: paths of the photographs in their folder.
        names: names in the file.
        where: the file, for messages.

    Raises:
        InputError: a name matches two photographs, for example a name without a folder and
            photographs of that name in two folders.

    Examples:
        >>> match_files(["a/IMG_1.JPG", "IMG_2.JPG"], ["img_1.jpg", "IMG_2"], Path("poses.xml"))
        {'a/IMG_1.JPG': 'img_1.jpg', 'IMG_2.JPG': 'IMG_2'}
    """
    found: dict[str, str] = {}
    unmatched = list(names)
    for normalize in _NORMALIZATIONS:
        names_by_form: dict[str, list[str]] = {}
        for name in unmatched:
            names_by_form.setdefault(normalize(name), []).append(name)
        file_by_name: dict[str, str] = {}
        for file in files:
            candidates = names_by_form.get(normalize(file), [])
            if file in found or len(candidates) != 1:
                continue
            first = file_by_name.setdefault(candidates[0], file)
            if first != file:
                raise _ambiguity_error(where, candidates[0], first, file)
            found[file] = candidates[0]
        unmatched = [name for name in unmatched if name not in file_by_name]
    # A matched name without a folder may also mean a photograph of that name in another folder.
    matched_files = {_fold_case(name): file for file, name in found.items()}
    for file in files:
        matched = matched_files.get(PurePosixPath(_fold_case(file)).name, file)
        if file not in found and matched != file:
            raise _ambiguity_error(where, found[matched], matched, file)
    return {file: found[file] for file in files if file in found}


def _ambiguity_error(where: Path, name: str, one: str, other: str) -> InputError:
    return InputError(
        f"{where}: {name!r} may be {one!r} or {other!r}: give names with their folder"
    )
