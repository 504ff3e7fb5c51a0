"""Names from outside, as they may be printed."""

from __future__ import annotations

import unicodedata

# Categories of Unicode that a terminal obeys, or that cannot be encoded: controls, formats that
# turn the direction of a line, halves of surrogates, ends of lines and paragraphs.
_HIDDEN = ("Cc", "Cf", "Cs", "Zl", "Zp")


def printed(text: object) -> str:
    """A name or a message on one line, with what a terminal would obey spelled out.

    Control characters, marks of direction and bytes of a file name that are not UTF-8 become
    Python's escapes: ``a\\x1b[31m.jpg``. A backslash stays as it is.
    """
    return "".join(
        character.encode("unicode_escape", "surrogatepass").decode("ascii")
        if unicodedata.category(character) in _HIDDEN
        else character
        for character in str(text)
    )


def drawn(text: object) -> str:
    """The same for Matplotlib, which takes what stands between two dollars for a formula."""
    return printed(text).replace("$", r"\$")
