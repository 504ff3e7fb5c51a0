"""The container installs the system libraries that rendering needs, and no others."""

from __future__ import annotations

import re
from pathlib import Path

from simulate.render.libraries import PACKAGES

ROOT = Path(__file__).parents[3]


def test_the_container_installs_the_libraries_of_rendering() -> None:
    text = (ROOT / "Dockerfile").read_text()
    found = re.search(r"--no-install-recommends \\\n(.*?)&&", text, re.DOTALL)
    assert found is not None
    installed = found[1].replace("\\", " ").split()
    assert sorted(installed) == sorted(["make", *PACKAGES.values()])
    assert 'CMD ["make", "demo"]' in text


def test_the_container_has_the_python_that_renders() -> None:
    assert (ROOT / "Dockerfile").read_text().splitlines()[1] == "FROM python:3.11-slim"
