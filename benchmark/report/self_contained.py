"""HTML pages that contain everything they show and need no network, server or other file.

A page ``NAME`` is made of ``templates/NAME.html``, ``.css`` and ``.js``, and may build on the style
and the script of another name, such as ``shared``. Its data is inserted as one block of JSON, which
is escaped so that no name in it can end the block. A content security policy names the one script
by its digest and allows no connection.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from importlib.resources import files
from string import Template
from typing import Any

from objconnect.scene.storage.digests import sha256


def fill(page: str, data: Mapping[str, Any], base: str | None = None) -> str:
    """Return the page of this name with its data.

    Args:
        page: name of the page.
        data: its data.
        base: name of a style and a script that stand before the page's own; None for none.
    """
    folder = files("benchmark.report") / "templates"
    names = (page,) if base is None else (base, page)
    style, script = (
        "".join((folder / f"{name}.{kind}").read_text(encoding="utf-8") for name in names)
        for kind in ("css", "js")
    )
    template = (folder / f"{page}.html").read_text(encoding="utf-8")
    return Template(template).substitute(
        style=style,
        script=script,
        style_digest=_digest(style),
        script_digest=_digest(script),
        data=embed(data),
    )


def embed(data: Mapping[str, Any]) -> str:
    """Return JSON for a script element, escaped so that no name in it can end the element."""
    text = json.dumps(data, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    # A file name may contain bytes that are not valid UTF-8.
    return text.encode("utf-8", "replace").decode("utf-8")


def _digest(text: str) -> str:
    return base64.b64encode(bytes.fromhex(sha256(text))).decode()
