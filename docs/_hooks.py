"""Make CONTRIBUTING.md of the repository a page of the site, and read docstrings as plain text."""

import logging
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]


def on_pre_build(**_: Any) -> None:
    """Let brackets side by side in a docstring be text, not a link that leads nowhere."""
    for handler in logging.getLogger("mkdocs").handlers:
        handler.addFilter(
            lambda record: (
                not (".py:" in record.getMessage() and "cross-ref" in record.getMessage())
            )
        )


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Replace the page contributing.md by CONTRIBUTING.md, with its links seen from docs/."""
    if page.file.src_uri != "contributing.md":
        return markdown
    return (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").replace("](docs/", "](")
