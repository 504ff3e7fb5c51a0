"""A published folder, and a cache of its own for its photographs."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from huggingface_hub import constants

from benchmark.publishing.command import publish
from benchmark.publishing.description import Release
from tests.benchmark.publishing.hub_server import Hub, hub_server
from tests.robustness.misuse.world import make_scene

STATED = Release(creator="A. Author", url="https://example.org/data", date="2026-05-17")


@pytest.fixture(autouse=True)
def photographs_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Unpack photographs into a folder of the test instead of the user's."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    return tmp_path / "xdg" / "objconnect" / "photographs"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small scene, and beside it the scene published."""
    folder = tmp_path_factory.mktemp("whole")
    make_scene(folder / "hamlet")
    publish([folder / "hamlet"], folder / "published", release=STATED)
    return folder


@pytest.fixture
def hamlet(whole: Path, tmp_path: Path) -> Path:
    """A copy of the scene."""
    return Path(shutil.copytree(whole / "hamlet", tmp_path / "hamlet"))


@pytest.fixture
def published(whole: Path, tmp_path: Path) -> Path:
    """A copy of the published folder."""
    return Path(shutil.copytree(whole / "published", tmp_path / "published"))


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hub]:
    """A stand-in that the library takes for the hub."""
    with hub_server() as running:
        template = constants.HUGGINGFACE_CO_URL_TEMPLATE
        monkeypatch.setattr(
            constants,
            "HUGGINGFACE_CO_URL_TEMPLATE",
            template.replace(constants.ENDPOINT, running.url),
        )
        monkeypatch.setattr(constants, "ENDPOINT", running.url)
        monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "hub"))
        yield running
