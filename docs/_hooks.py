"""Show files of the root and the leaderboard on the site, and read docstrings as plain text.

The build fails where a document states other figures than the stored results.
"""

import logging
import shutil
import subprocess
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
BOARD = ROOT / "runs" / "leaderboard" / "leaderboard.html"
# Pages of the site that are files of the repository's root.
FILES = {
    "index.md": "README.md",
    "contributing.md": "CONTRIBUTING.md",
    "changelog.md": "CHANGELOG.md",
}
PYTHON = ROOT / ".venv" / "bin" / "python"

log = logging.getLogger("mkdocs.hooks")


def on_pre_build(**_: Any) -> None:
    """Compare figures with the stored results, and let brackets in a docstring be text.

    The site's own environment lacks the project: figures are compared by that of ``make install``.
    """
    if PYTHON.is_file():
        command = [PYTHON, "-m", "experiments.figures"]
        found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        if found.returncode:
            log.warning("%s", found.stdout + found.stderr.splitlines()[-1])
    else:
        log.info("figures are not compared with the stored results: there is no %s", PYTHON)
    for handler in logging.getLogger("mkdocs").handlers:
        handler.addFilter(
            lambda record: (
                not (".py:" in record.getMessage() and "cross-ref" in record.getMessage())
            )
        )


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Show a file of the root in place of its page, with links as seen from docs/."""
    if page.file.src_uri not in FILES:
        return markdown
    text = (ROOT / FILES[page.file.src_uri]).read_text(encoding="utf-8").replace("](docs/", "](")
    for shown, file in FILES.items():
        text = text.replace(f"]({file})", f"]({shown})")
    return text


def on_post_build(*, config: Any, **_: Any) -> None:
    """Put the page of all tracks in the place of docs/board.html."""
    if BOARD.is_file():
        shutil.copyfile(BOARD, Path(config["site_dir"]) / "board.html")
    else:
        log.warning("there is no %s: run make leaderboard", BOARD)
