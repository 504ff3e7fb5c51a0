"""File names and messages escaped for a terminal or a figure."""

from __future__ import annotations

import unicodedata

# Unicode categories that control a terminal or cannot be encoded: control characters, format
# characters such as those for text direction, surrogates, line and paragraph separators.
_HIDDEN = ("Cc", "Cf", "Cs", "Zl", "Zp")


def for_terminal(text: object) -> str:
    r"""Return a name or message on one line, with everything that controls a terminal escaped.

    Control characters, marks of text direction and bytes of a file name that are not UTF-8 become
    Python's escapes. A backslash is not changed.

    Example:
        >>> print(for_terminal("a" + chr(27) + "[31m.jpg"))
        a\x1b[31m.jpg
    """
    return "".join(
        character.encode("unicode_escape", "surrogatepass").decode("ascii")
        if unicodedata.category(character) in _HIDDEN
        else character
        for character in str(text)
    )


def for_figure(text: object) -> str:
    """Return a name or message escaped for Matplotlib, which reads text between dollars as a
    formula."""
    return for_terminal(text).replace("$", r"\$")
