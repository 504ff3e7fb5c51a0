"""Make CONTRIBUTING.md and the leaderboard pages of the site, and read docstrings as plain text."""

import logging
import shutil
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
BOARD = ROOT / "runs" / "leaderboard" / "leaderboard.html"


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


def on_post_build(*, config: Any, **_: Any) -> None:
    """Put the page of all tracks in the place of docs/board.html."""
    if BOARD.is_file():
        shutil.copyfile(BOARD, Path(config["site_dir"]) / "board.html")
    else:
        logging.getLogger("mkdocs.hooks").warning("there is no %s: run make leaderboard", BOARD)
