"""Which photographs the names of another program's file mean."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath
from typing import Final

from objconnect.scene.errors import InputError

_Spelling = Callable[[str], str]


def _fold_case(name: str) -> str:
    return name.replace("\\", "/").casefold()


# From strict to loose: paths and file names as they are, without regard to case and with "\" as
# "/", and file names without their endings.
_SPELLINGS: Final[tuple[_Spelling, ...]] = (
    lambda name: name,
    lambda name: PurePosixPath(name).name,
    _fold_case,
    lambda name: PurePosixPath(_fold_case(name)).name,
    lambda name: PurePosixPath(_fold_case(name)).stem,
)


def match_files(files: Sequence[str], names: Sequence[str], where: Path) -> dict[str, str]:
    """Return the name that means each photograph; photographs without one are left out.

    Paths are compared first, then file names, then both without regard to case, and last file names
    without their endings, which labels of Metashape lack. A name that means a photograph by a
    stricter comparison means no other by a looser one.

    Args:
        files: paths of the photographs in their folder.
        names: names in the file.
        where: the file, for messages.

    Raises:
        InputError: a name may mean two photographs, as one without a folder where photographs in
            two folders are called so and only one of them is meant exactly.

    Example:
        >>> match_files(["a/IMG_1.JPG", "IMG_2.JPG"], ["img_1.jpg", "IMG_2"], Path("poses.xml"))
        {'a/IMG_1.JPG': 'img_1.jpg', 'IMG_2.JPG': 'IMG_2'}
    """
    found: dict[str, str] = {}
    free = list(names)
    for spelled in _SPELLINGS:
        named: dict[str, list[str]] = {}
        for name in free:
            named.setdefault(spelled(name), []).append(name)
        owners: dict[str, str] = {}
        for file in files:
            alike = named.get(spelled(file), [])
            if file in found or len(alike) != 1:
                continue
            other = owners.setdefault(alike[0], file)
            if other != file:
                raise _ambiguity_error(where, alike[0], other, file)
            found[file] = alike[0]
        free = [name for name in free if name not in owners]
    bare = {_fold_case(name): file for file, name in found.items()}
    for file in files:
        other = bare.get(PurePosixPath(_fold_case(file)).name, file)
        if file not in found and other != file:
            raise _ambiguity_error(where, found[other], other, file)
    return {file: found[file] for file in files if file in found}


def _ambiguity_error(where: Path, name: str, one: str, other: str) -> InputError:
    said = f"{name!r} may be {one!r} or {other!r}: give names with their folder"
    return InputError(f"{where}: {said}")
