"""Words of a command line that are not taken as they were meant.

``--set a=1 b=2`` gives ``--set`` one value, and the command an argument ``b=2``. Where a command
takes data sets, the second word would be looked for as one. ``--start --out DIR`` gives ``--start``
the value ``--out``, and the command an argument ``DIR``.
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
    """Refuse a word KEY=VALUE that no option takes, in a command that has ``--set``.

    Args:
        command: a command of click.
        words: what follows its name.

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
    """Refuse an option of a command that another one, which was given no value, takes as its own.

    Args:
        command: a command of click.
        words: what follows its name.

    Raises:
        InputError: there is such an option. Behind an equals sign, any value may stand.
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
            raise InputError(f"{word} has no value: {value} follows it")


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
            # Whoever parses the line refuses an unknown option; nothing is known of its value.
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
