"""Escaping of file names and messages for a terminal or a figure."""

from __future__ import annotations

import unicodedata

# Unicode categories that control a terminal or cannot be encoded: control and format characters,
# surrogates, line and paragraph separators.
_ESCAPED_CATEGORIES = ("Cc", "Cf", "Cs", "Zl", "Zp")


def for_terminal(text: object) -> str:
    r"""Return a text on one line, with Python escapes for characters that control a terminal.

    Bytes of a file name that are not UTF-8 are escaped too. A backslash is not changed.

    Examples:
        >>> print(for_terminal("a" + chr(27) + "[31m.jpg"))
        a\x1b[31m.jpg
    """
    return "".join(
        character.encode("unicode_escape", "surrogatepass").decode("ascii")
        if unicodedata.category(character) in _ESCAPED_CATEGORIES
        else character
        for character in str(text)
    )


def for_figure(text: object) -> str:
    """Return a text escaped for Matplotlib, which parses text between dollars as a formula."""
    return for_terminal(text).replace("$", r"\$")
