"""Addresses on the hub, against a stand-in on this machine."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from huggingface_hub import constants

from benchmark.datasets.open import open_datasets
from benchmark.publishing.weights.benchmarks import write_scores
from benchmark.publishing.weights.command import publish_weights
from objconnect.methods import create
from objconnect.scene.errors import InputError
from tests.benchmark.publishing.hub_server import REPOSITORY, Hub

ABSENT = "0" * 40


def test_a_commit_is_the_data_set_that_was_published(
    hub: Hub, published: Path, hamlet: Path
) -> None:
    address = Path(f"hf://{REPOSITORY}@{hub.commit_folder(published)}")
    (dataset,) = open_datasets(address)
    assert dataset.sha256 == open_datasets(hamlet)[0].sha256
    assert not any("pictures/" in request for request in hub.requests)
    hub.requests.clear()
    assert open_datasets(address)[0].sha256 == dataset.sha256
    assert hub.requests == []


@pytest.mark.parametrize(
    ("address", "says"),
    [
        (
            f"hf://{REPOSITORY}",
            f"hf://{REPOSITORY} names no commit of a data set: write hf://OWNER",
        ),
        (f"hf://{REPOSITORY}@main", "names no commit"),
        (f"hf://{REPOSITORY}@v1.0.0", "names no commit"),
        ("hf://fields@" + ABSENT, "names no commit"),
        (f"hf://{REPOSITORY}@{ABSENT}", "the repository has no such commit"),
        (f"hf://owner/others@{ABSENT}", "the hub has no such data set, or you may not read it"),
    ],
)
def test_a_wrong_address_is_one_line(address: str, says: str, hub: Hub) -> None:
    with pytest.raises(InputError, match=says) as raised:
        open_datasets(Path(address))
    assert "\n" not in str(raised.value)


def test_a_repository_of_other_files_is_named(hub: Hub) -> None:
    commit = hub.commit({"README.md": b"# Others\n"})
    with pytest.raises(InputError, match=r"published\.json"):
        open_datasets(Path(f"hf://{REPOSITORY}@{commit}"))


def test_a_hub_that_cannot_be_reached_is_one_line(
    hub: Hub, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(constants, "ENDPOINT", "http://127.0.0.1:9")
    with pytest.raises(InputError, match="cannot be downloaded: ") as raised:
        open_datasets(Path(f"hf://{REPOSITORY}@{ABSENT}"))
    assert "\n" not in str(raised.value)


def upload(hub: Hub, folder: Path, *options: str) -> str:
    """Upload a folder as the guide does, and return its address."""
    hf = Path(sys.executable).with_name("hf")
    own = {"HF_ENDPOINT": hub.url, "HF_TOKEN": "hf_test", "HF_HOME": str(folder.parent / "home")}
    words = ["upload", REPOSITORY, str(folder), *options]
    subprocess.run([hf, *words], check=True, env={**os.environ, **own}, capture_output=True)
    (commit,) = hub.commits
    return f"hf://{REPOSITORY}@{commit}"


@pytest.mark.thorough
def test_the_documented_upload_can_be_evaluated(hub: Hub, published: Path, hamlet: Path) -> None:
    address = upload(hub, published, "--repo-type", "dataset")
    (dataset,) = open_datasets(Path(address))
    assert dataset.sha256 == open_datasets(hamlet)[0].sha256


@pytest.mark.thorough
def test_the_documented_upload_of_weights_can_be_used(hub: Hub, tmp_path: Path) -> None:
    report = publish_weights("pixloc", tmp_path / "model")
    write_scores(tmp_path / "model", {"fields-pixloc.yaml": [{"value": 50.0}]})
    address = upload(hub, tmp_path / "model")
    assert b"50.0" in next(iter(hub.commits.values()))[".eval_results/fields-pixloc.yaml"]
    assert create("pixloc", {"weights": address}).weights_sha256 == report.sha256
