"""Published weights: files as they are, a card with stored results, and use of the folder."""

from __future__ import annotations

import errno
import hashlib
import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from huggingface_hub import ModelCard, parse_eval_result_entries

from baselines.pixloc.localizer import SHIPPED
from benchmark.publishing.description import Release
from benchmark.publishing.index import INDEX
from benchmark.publishing.weights import command
from benchmark.publishing.weights.command import publish_weights
from benchmark.results.query_result import QueryResult
from benchmark.results.results import DatasetId, Results
from benchmark.results.results_files import load
from objconnect.learning.pixloc_net import read_network
from objconnect.learning.weights_file import find_weights
from objconnect.localization.provenance import Method
from objconnect.methods import create
from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.storage.checksums import CHECKSUMS
from objconnect.scene.storage.digests import sha256_of
from tests.benchmark.publishing.hub_server import REPOSITORY, Hub

SHA256 = sha256_of(SHIPPED)
ERRORS = (0.1, 0.4, 3.0, 9.0)  # of the four queries of each made results file, metres


def write_results(folder: Path, dataset: str, start: str, weights: str, sha256: str) -> Path:
    """Results of pixloc on four queries, two of which are within 0.5 m."""
    queries = [
        QueryResult.model_validate(
            {
                "name": f"{number}.jpg",
                "condition": "winter-noon",
                "group": f"flight-{number % 2}",
                "altitude_m": 60.0,
                "status": "ok",
                "reason": "",
                "t_err_m": metres,
                "r_err_deg": 0.1,
                "cam_from_world": (1, 0, 0, 0, 0, 0, 0),
                "sigma_t_m": None,
                "nees": None,
                "iterations": 1,
                "inliers": 9,
                "seconds": {"total": 0.1},
            }
        )
        for number, metres in enumerate(ERRORS)
    ]
    method = Method(name="pixloc", config={"references": 5}, weights_sha256=weights)
    identity = DatasetId(
        name=dataset, track="uav-sim", sha256=sha256, map_conditions=("summer-noon",)
    )
    path = folder / dataset / "pixloc.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    Results.of(method, identity, start, queries).write(path)
    return path


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """The weights of pixloc, published with one results file of theirs and one of others."""
    write_results(tmp_path / "results", "park", "error=3m,5deg", SHA256, "0" * 64)
    write_results(tmp_path / "results", "town", "error=3m,5deg", "1" * 64, "0" * 64)
    out = tmp_path / "model"
    report = publish_weights("pixloc", out, [tmp_path / "results"], release=Release(creator="A. B"))
    assert (report.results, report.left_out) == (1, 1)
    assert report.written == sum(f.stat().st_size for f in out.rglob("*") if f.is_file())
    return out


def test_files_are_as_they_were_and_listed(model: Path, tmp_path: Path) -> None:
    copied = "results/error=3m,5deg/park/pixloc.json"
    names = {p.relative_to(model).as_posix() for p in model.rglob("*") if p.is_file()}
    assert names == {"README.md", "pixloc.safetensors", copied, CHECKSUMS}
    assert (model / "pixloc.safetensors").read_bytes() == SHIPPED.read_bytes()
    assert load(model / copied) == load(tmp_path / "results/park/pixloc.json")
    checked = subprocess.run(["sha256sum", "-c", "--quiet", CHECKSUMS], cwd=model, check=False)
    assert checked.returncode == 0


def test_the_card_tells_data_licence_limits_and_stored_figures(model: Path) -> None:
    card = ModelCard.load(model / "README.md")
    assert (card.data.license, card.data.library_name) == ("apache-2.0", "objconnect")
    text = " ".join(card.text.split())
    for fact in (
        "farmland 1241 to 1246",
        "Andrew Zaborowski, 2012, CC-BY 3.0",
        "[Apache-2.0](https://spdx.org/licenses/Apache-2.0.html), A. B",
        "trained mostly on renders of one simulator",
        f"sha256 `{SHA256}`",
        "| park | uav-sim | `error=3m,5deg` | pixloc |",
        "objconnect evaluate DATASET --method METHOD --set weights=FOLDER --start START",
    ):
        assert fact in text
    assert "| 4 | 25.0 [" in text and "| 50.0 [" in text and "| 75.0 [" in text
    assert "town |" not in text


def test_a_dry_run_tells_the_bytes_and_writes_nothing(tmp_path: Path) -> None:
    report = publish_weights("pixloc", tmp_path / "out", dry_run=True)
    assert report.size == SHIPPED.stat().st_size
    assert "would hold about" in report.text()
    assert list(tmp_path.iterdir()) == []


def test_a_method_takes_the_folder(model: Path) -> None:
    assert read_network(model)[1] == SHA256
    assert create("pixloc", {"weights": str(model)}).weights_sha256 == SHA256


def test_calibration_files_go_with_the_weights(tmp_path: Path) -> None:
    own = own_weights(tmp_path)
    calibration = "bias: 1.0\n"
    own.with_suffix(".acceptance.yaml").write_text(calibration)
    (tmp_path / "other.acceptance.yaml").write_text("bias: 2.0\n")
    out = tmp_path / "model"
    publish_weights(str(own), out, release=Release(license="MIT"))
    weights = find_weights(out)
    assert weights.with_suffix(".acceptance.yaml").read_text() == calibration
    assert not (out / "other.acceptance.yaml").exists()
    (out / "own.acceptance.yaml").write_text("bias: 3.0\n")
    with pytest.raises(InputError, match="own.acceptance.yaml is not the file that was published"):
        find_weights(out)


def own_weights(folder: Path, name: str = "own") -> Path:
    """A file of weights with its card."""
    file = folder / f"{name}.safetensors"
    shutil.copyfile(SHIPPED, file)
    file.with_suffix(".md").write_text(f"# Weights of pixloc\n\n- trained on: mine, {SHA256}\n")
    return file


def without_card(folder: Path) -> str:
    file = own_weights(folder)
    file.with_suffix(".md").unlink()
    return str(file)


def with_card(text: str) -> Callable[[Path], str]:
    def make(folder: Path) -> str:
        file = own_weights(folder)
        file.with_suffix(".md").write_text(text)
        return str(file)

    return make


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda folder: "pixlok", "'pixlok' is neither a .safetensors file nor one of objconnect,"),
        (lambda folder: str(folder / "no.safetensors"), "no.safetensors"),
        (without_card, "own.safetensors has no card: describe data, training and limits in"),
        (with_card("# Mine\n"), "the first line is not '# Weights of METHOD'"),
        (
            with_card("# Weights of pixloc\n"),
            r"does not describe .*own.safetensors: it lacks its sha256",
        ),
        (with_card(""), "the first line is not"),
    ],
)
def test_weights_that_cannot_be_published_are_one_line(
    make: Callable[[Path], str], says: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=says) as raised:
        publish_weights(make(tmp_path), tmp_path / "out", release=Release(license="MIT"))
    assert "\n" not in str(raised.value)
    assert not (tmp_path / "out").exists()


def test_own_weights_need_a_licence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="state the licence of your weights with --license"):
        publish_weights(str(own_weights(tmp_path)), tmp_path / "out")


def test_results_of_other_weights_alone_are_refused(tmp_path: Path) -> None:
    results = write_results(tmp_path / "results", "town", "none", "1" * 64, "0" * 64)
    with pytest.raises(InputError, match="none of the 1 results files is of these weights"):
        publish_weights("pixloc", tmp_path / "out", [results])
    first = write_results(tmp_path / "a", "town", "none", SHA256, "0" * 64)
    second = write_results(tmp_path / "b", "town", "none", SHA256, "2" * 64)
    with pytest.raises(InputError, match="would both be results/none/town/pixloc.json"):
        publish_weights("pixloc", tmp_path / "out", [first, second])
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("step", ["write_model_card", "write_checksums"])
def test_a_full_disk_leaves_nothing_behind(
    step: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(command, step, fail)
    with pytest.raises(WriteError, match=f"cannot write {tmp_path / 'out'}: No space left"):
        publish_weights("pixloc", tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def spoil_weights(folder: Path) -> None:
    content = bytearray((folder / "pixloc.safetensors").read_bytes())
    content[-1] ^= 1
    (folder / "pixloc.safetensors").write_bytes(content)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (spoil_weights, "pixloc.safetensors is not the file that was published"),
        (lambda f: (f / "pixloc.safetensors").unlink(), "pixloc.safetensors does not exist"),
        (lambda f: (f / CHECKSUMS).unlink(), "is a folder without SHA256SUMS"),
        (lambda f: (f / CHECKSUMS).write_text("a b\n"), "line 1: it is not DIGEST  FILE"),
        (lambda f: (f / CHECKSUMS).write_text("0" * 64 + "  ../x\n"), "line 1: it is not"),
        (lambda f: (f / CHECKSUMS).write_bytes(b"\xff\xfe"), "is not a UTF-8 text file"),
        (lambda f: (f / CHECKSUMS).write_text(""), "lists 0 files of weights"),
    ],
)
def test_a_damaged_folder_is_one_line(
    spoil: Callable[[Path], None], says: str, model: Path
) -> None:
    spoil(model)
    with pytest.raises(InputError, match=says) as raised:
        create("pixloc", {"weights": str(model)})
    assert "\n" not in str(raised.value)


def test_a_commit_on_the_hub_is_the_weights(hub: Hub, model: Path) -> None:
    address = f"hf://{REPOSITORY}@{hub.commit_folder(model)}"
    assert create("pixloc", {"weights": address}).weights_sha256 == SHA256
    assert not any("results/" in request for request in hub.requests if "/resolve/" in request)
    hub.requests.clear()
    assert create("pixloc", {"weights": address}).weights_sha256 == SHA256
    assert hub.requests == []
    with pytest.raises(InputError, match=r"hf://owner/fields@main names no commit of a model"):
        create("pixloc", {"weights": f"hf://{REPOSITORY}@main"})


def test_scores_are_those_of_the_whole_data_set(hub: Hub, published: Path, tmp_path: Path) -> None:
    index = json.loads((published / INDEX).read_text())
    second = index["scenes"][0] | {"name": "second", "sha256": "2" * 64}
    (published / INDEX).write_text(json.dumps(index | {"scenes": [index["scenes"][0], second]}))
    commit = hub.commit_folder(published)
    address = Path(f"hf://{REPOSITORY}@{commit}")
    first_sha256 = index["scenes"][0]["sha256"]
    write_results(tmp_path / "results", "hamlet", "gps=50m", SHA256, first_sha256)
    with pytest.raises(InputError, match="no method has results of all its 2 scenes"):
        publish_weights("pixloc", tmp_path / "out", [tmp_path / "results"], [address])
    assert not (tmp_path / "out").exists()
    write_results(tmp_path / "results", "second", "gps=50m", SHA256, "2" * 64)
    publish_weights("pixloc", tmp_path / "out", [tmp_path / "results"], [address])
    (file,) = (tmp_path / "out/.eval_results").iterdir()
    assert file.name == "fields-pixloc.yaml"
    (score,) = parse_eval_result_entries(yaml.safe_load(file.read_text()))
    assert (score.dataset_id, score.dataset_revision) == (REPOSITORY, commit)
    assert (score.task_id, score.value) == ("gps-50m", 50.0)
    assert score.notes == "pixloc from start gps=50m: recall within 0.5 m 5° in %, 8 queries"
    listed = (tmp_path / "out" / CHECKSUMS).read_text()
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    assert f"{digest}  .eval_results/fields-pixloc.yaml" in listed
    assert {r.rpartition("/")[2] for r in hub.requests if "/resolve/" in r} == {INDEX}
