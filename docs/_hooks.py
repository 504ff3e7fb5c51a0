"""Make CONTRIBUTING.md of the repository a page of the site."""

import logging
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]

# Docstrings are plain text: two brackets side by side in them are not a link that leads nowhere.
logging.getLogger("mkdocs.plugins.mkdocs_autorefs").addFilter(
    lambda record: ".py:" not in record.getMessage()
)


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Replace the page contributing.md by CONTRIBUTING.md, with its links seen from docs/."""
    if page.file.src_uri != "contributing.md":
        return markdown
    return (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").replace("](docs/", "](")
