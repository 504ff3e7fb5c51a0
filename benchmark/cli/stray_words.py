"""Detection of words that click would assign to the wrong option or argument.

In ``--set a=1 b=2``, click passes ``b=2`` to the command as an argument, such as a data set. In
``--start --out DIR``, it takes ``--out`` as the value of ``--start``, and ``DIR`` as an argument.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from typing import Any, Final

from objconnect.scene.errors import InputError

_SET: Final = "--set"
_SETTING: Final = re.compile(r"[A-Za-z_][\w.]*=.*", re.DOTALL)


def refuse_stray_settings(command: Any, words: Sequence[str]) -> None:
    """Refuse a word KEY=VALUE without its own ``--set``, in a command that has this option.

    Args:
        command: a command of click.
        words: the words after its name.

    Raises:
        InputError: there is such a word, and no file or folder has its name.
    """
    options = _options(command)
    if _SET not in options:
        return
    for word in _arguments(options, words):
        if _SETTING.fullmatch(word) and not _is_path(word):
            raise InputError(
                f"{word!r} stands alone: {_SET} is given once per value, so write {_SET} {word}"
            )


def refuse_taken_options(command: Any, words: Sequence[str]) -> None:
    """Refuse an option name that click would take as the value of the option before it.

    Args:
        command: a command of click.
        words: the words after its name.

    Raises:
        InputError: there is such a name. A value after an equals sign may be any word.
    """
    options = _options(command)
    following = iter(words)
    for word in following:
        if word == "--":
            return
        if word not in options or options[word].is_flag:
            continue
        value = next(following, None)
        if value is not None and value.partition("=")[0] in options:
            raise InputError(f"{word} has no value: {value} follows it; give {word} a value")


def _options(command: Any) -> dict[str, Any]:
    """Return the options of a command by name; an argument has a name without dashes."""
    named = {name: option for option in command.params for name in option.opts}
    return {name: option for name, option in named.items() if name.startswith("--")}


def _arguments(options: dict[str, Any], words: Sequence[str]) -> Iterator[str]:
    """Yield the words that are neither options nor their values."""
    following = iter(words)
    for word in following:
        if word == "--":
            yield from following
        elif word.startswith("--"):
            name, equals, _ = word.partition("=")
            option = options.get(name)
            # click refuses an unknown option; whether it takes a value is unknown.
            if option is None:
                return
            if not equals and not option.is_flag:
                next(following, None)
        else:
            yield word


def _is_path(word: str) -> bool:
    """Return whether a file or folder has this name."""
    try:
        return os.path.lexists(word)
    except ValueError:  # a null byte
        return False
