"""Downloads from the Hugging Face hub; the only module that imports its library."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal

from objconnect.scene.errors import InputError
from objconnect.scene.runtime.extras import import_extra

Kind = Literal["dataset", "model"]
"""Kind of a repository on the hub."""

# ``Path`` makes one slash of the two in an address.
_SCHEME: Final = re.compile(r"^hf:/+")
_ADDRESS: Final = re.compile(r"^hf:/+([\w.-]+/[\w.-]+)@([0-9a-f]{40})$")
_FORM: Final = "hf://OWNER/NAME@COMMIT, where COMMIT has 40 digits"
_WORDS: Final[dict[Kind, str]] = {"dataset": "data set", "model": "model"}


def is_address(path: Path) -> bool:
    """Return whether a path is written like an address on the hub.

    Examples:
        >>> is_address(Path("hf://owner/name@main")), is_address(Path("scenes/town"))
        (True, False)
    """
    return _SCHEME.match(path.as_posix()) is not None


def parse_address(address: Path, kind: Kind) -> tuple[str, str]:
    """Return repository and commit of ``hf://OWNER/NAME@COMMIT``.

    A branch or a tag is refused, because it may lead to other files later.

    Raises:
        InputError: the address names no commit.
    """
    match = _ADDRESS.match(address.as_posix())
    if match is None:
        raise InputError(f"{_text(address)} names no commit of a {_WORDS[kind]}: write {_FORM}")
    return match[1], match[2]


def download(
    address: Path, kind: Kind, include: Sequence[str] | None = None, exclude: Sequence[str] = ()
) -> Path:
    """Download the files of a repository at one commit, unless the library's cache holds them.

    Args:
        address: ``hf://OWNER/NAME@COMMIT``.
        kind: kind of the repository.
        include: patterns of the files to download; None for all.
        exclude: patterns of files that are not downloaded.

    Returns:
        The folder of the files.

    Raises:
        InputError: the address names no commit, the hub has no such repository or commit, it
            cannot be reached, or huggingface_hub is not installed.
    """
    repository, commit = parse_address(address, kind)
    text, word = _text(address), _WORDS[kind]
    hub = import_extra("huggingface_hub", "hub", f"a {word} on the hub")
    errors = import_extra("huggingface_hub.errors", "hub", f"a {word} on the hub")
    try:
        return Path(
            hub.snapshot_download(
                repository,
                repo_type=kind,
                revision=commit,
                allow_patterns=None if include is None else list(include),
                ignore_patterns=list(exclude),
            )
        )
    except errors.RevisionNotFoundError:
        raise InputError(f"{text}: the repository has no such commit: check its digits") from None
    except errors.RepositoryNotFoundError:
        raise InputError(
            f"{text}: the hub has no such {word}, or you may not read it: see 'hf auth login'"
        ) from None
    except Exception as error:  # releases of huggingface_hub raise errors of different libraries
        reason = " ".join(str(error).split())
        raise InputError(f"{text} cannot be downloaded: {reason}") from None


def _text(address: Path) -> str:
    return _SCHEME.sub("hf://", address.as_posix())
