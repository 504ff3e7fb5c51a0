"""Real photographs, made small so that tests are quick."""

from __future__ import annotations

from pathlib import Path

import pytest

from ingest.command import ingest
from ingest.report import IngestReport
from scene.bundle.scene import Scene
from scene.storage.images import write_resized

SIDE = 500


@pytest.fixture(scope="session")
def photographs(beach: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All photographs of a real flight as its pilot would hand them over, but small."""
    folder = tmp_path_factory.mktemp("photographs")
    for path in sorted((beach / "photos").iterdir()):
        write_resized(path, folder / path.name, SIDE)
    return folder


@pytest.fixture(scope="session")
def ingested(
    photographs: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Scene, IngestReport]:
    """The scene of them. Tests that change it take a copy."""
    out = tmp_path_factory.mktemp("ingested") / "shore"
    report = ingest(photographs, out)
    return Scene.open(out), report
