"""Flags that files write as truth values, numbers or words."""

from __future__ import annotations

from typing import Final

_WORDS: Final = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}


def parse_flag(value: object) -> bool | None:
    """Return whether a flag is set; None if the value is not a flag.

    Examples:
        >>> parse_flag("True"), parse_flag(0), parse_flag("maybe"), parse_flag(2)
        (True, False, None, None)
    """
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return _WORDS.get(str(value).strip().lower())
