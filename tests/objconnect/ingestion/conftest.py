"""Real photographs, made small so that tests are quick."""

from __future__ import annotations

from pathlib import Path

import pytest

from objconnect.ingestion.command import ingest
from objconnect.ingestion.report import REPORT, IngestReport
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.storage.exif import resize_file
from tests.shared import make_once

SIDE = 500


@pytest.fixture(autouse=True)
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw flights in fixtures of a wider scope alone: a picture takes a fifth of a small run."""
    for module in ("command", "addition"):
        monkeypatch.setattr(f"objconnect.ingestion.{module}.draw", lambda *_: None)


@pytest.fixture(scope="session")
def photographs(beach: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All photographs of a real flight as its pilot would hand them over, but small."""

    def make(folder: Path) -> None:
        for path in sorted((beach / "photos").iterdir()):
            resize_file(path, folder / path.name, SIDE)

    return make_once(tmp_path_factory, "photographs", make)


@pytest.fixture(scope="session")
def ingested(
    photographs: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Scene, IngestReport]:
    """The scene of them. Tests that change it take a copy."""
    made = make_once(
        tmp_path_factory, "ingested", lambda folder: ingest(photographs, folder / "shore")
    )
    out = made / "shore"
    return Scene.open(out), IngestReport.model_validate_json((out / REPORT).read_text())
