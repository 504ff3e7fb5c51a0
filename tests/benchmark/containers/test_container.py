"""``evaluate --container``: what the container reads, how it is started, and what it may write.

A script stands in for Docker; where a daemon answers, a last test runs a real container.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from benchmark.cli import app
from benchmark.containers.command import Container, evaluate_container
from benchmark.containers.data import write_data
from benchmark.containers.runtime import Limits, docker_command, run_container
from benchmark.datasets.dataset import BenchmarkQuery, Dataset
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.starts import NONE, PRIOR, parse_start
from benchmark.results.results_files import load
from objconnect.scene.errors import InputError
from objconnect.scene.flights.textfiles import pose_line, read_cameras, read_pairs
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.colmap_files import read_model
from tests.robustness.misuse.world import make_scene

# Stands for Docker: it tells an image's digest, keeps the words of ``run``, and runs the program
# "$BODY" with the folders of both mounts.
DOCKER = r"""#!/bin/bash
case "$1" in
  image) echo sha256:feed ;;
  kill) echo "$2" > "$STATE/killed"; kill "$(cat "$STATE/pid")" ;;
  run)
    printf '%s\n' "$@" > "$STATE/words"
    for word; do
      case "$word" in
        *target=/data*) data="${word#*source=}"; data="${data%%\"*}" ;;
        *target=/output*) output="${word#*source=}"; output="${output%%\"*}" ;;
      esac
    done
    echo $$ > "$STATE/pid"
    eval "$BODY" ;;
esac
"""


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which the stand-in keeps what it was called with."""
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "docker").write_text(DOCKER)
    (tmp_path / "bin" / "docker").chmod(0o755)
    (tmp_path / "state").mkdir()
    monkeypatch.setenv("STATE", str(tmp_path / "state"))
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}")
    return tmp_path / "state"


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    (dataset,) = open_datasets(make_scene(tmp_path / "hamlet"))
    return dataset


def container() -> Container:
    return Container("example/theirs:1.0", "theirs", Limits())


def test_a_container_reads_all_but_reference_poses(dataset: Dataset, tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.mkdir()
    write_data(dataset, PRIOR, data)
    sparse_map = read_model(data / "map")
    assert sparse_map.names == dataset.load_map().names
    assert all((data / "images" / name).is_file() for name in sparse_map.names)
    cameras = read_cameras(data / "queries.txt")
    assert list(cameras) == [query.name for query in dataset.queries]
    priors = json.loads((data / "priors.json").read_text())
    for query in dataset.queries:
        assert cameras[query.name] == query.camera
        with Image.open(data / "queries" / f"{query.name}.png") as picture:
            assert not picture.info
            assert np.array_equal(np.asarray(picture), query.load().image)
        assert query.prior is not None
        assert priors[query.name]["position"] == query.prior.position.tolist()
        told = Pose.from_quaternion(priors[query.name]["cam_from_world"], [0, 0, 0])
        assert np.allclose(told.rotation.numpy(), query.prior.cam_from_world_rotation)
    # With other reference poses, every byte is the same.
    moved = replace(dataset, queries=tuple(map(move, dataset.queries)))
    (tmp_path / "other").mkdir()
    write_data(moved, PRIOR, tmp_path / "other")
    assert files_of(tmp_path / "other") == files_of(data)


def move(query: BenchmarkQuery) -> BenchmarkQuery:
    reference = Pose(query.reference.rotation, query.reference.translation + 1.5)
    return replace(query, reference=reference)


def files_of(folder: Path) -> dict[str, bytes]:
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


@pytest.mark.parametrize("start", ["none", "gravity", "gps=5m"])
def test_a_container_is_told_what_the_start_gives(
    start: str, dataset: Dataset, tmp_path: Path
) -> None:
    write_data(dataset, parse_start(start), tmp_path)
    path = tmp_path / "priors.json"
    assert path.exists() == (start != "none")
    if path.exists():
        prior = json.loads(path.read_text())[dataset.queries[0].name]
        assert (prior["position"] is None) == (start == "gravity")
        assert (prior["cam_from_world"] is None) == (start == "gps=5m")
        assert prior["has_heading"] is False


def test_pairs_are_those_of_the_start(dataset: Dataset, tmp_path: Path) -> None:
    reference = dataset.load_map().names[0]
    lines = [f"{query.name} {reference}" for query in dataset.queries]
    (tmp_path / "pairs.txt").write_text("\n".join(lines))
    (tmp_path / "data").mkdir()
    write_data(dataset, parse_start(f"pairs={tmp_path / 'pairs.txt'}"), tmp_path / "data")
    pairs = read_pairs(tmp_path / "data" / "pairs.txt")
    assert pairs == {query.name: (reference,) for query in dataset.queries}


def test_the_command_isolates_the_container(tmp_path: Path) -> None:
    config = Limits(memory_gb=2, cpus=1.5)
    folder = tmp_path / 'a,"b'
    words = docker_command("name", "sha256:feed", folder / "data", folder / "output", config)
    assert words[:2] == ["docker", "run"]
    assert words[-1] == "sha256:feed"
    pairs = set(pairwise(words))
    assert pairs >= {
        ("--network", "none"),
        ("--memory", "2000000000b"),
        ("--memory-swap", "2000000000b"),
        ("--cpus", "1.5"),
        ("--cap-drop", "ALL"),
        ("--security-opt", "no-new-privileges"),
        ("--pull", "never"),
        ("--user", f"{os.getuid()}:{os.getgid()}"),
    }
    assert {"--rm", "--read-only"} <= set(words)
    mounts = [word for before, word in pairs if before == "--mount"]
    quoted = str(folder.resolve()).replace('"', '""')
    assert sorted(mounts) == [
        f'type=bind,"source={quoted}/data",target=/data,readonly',
        f'type=bind,"source={quoted}/output",target=/output',
    ]


def test_poses_of_a_container_are_scored(
    dataset: Dataset, state: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = [pose_line(query.name, query.reference, 9) for query in dataset.queries[:-1]]
    (tmp_path / "answers.txt").write_text("\n".join(lines))
    body = f'test -f "$data/queries.txt" && cp "{tmp_path / "answers.txt"}" "$output/poses.txt"'
    monkeypatch.setenv("BODY", body)
    words = ["evaluate", tmp_path / "hamlet", "--container", "example/theirs:1.0"]
    words += ["--method", "theirs", "--start", "none", "--set", "minutes=5", "--json"]
    result = CliRunner().invoke(app, [*map(str, words), "--out", str(tmp_path / "results")])
    assert result.exit_code == 0, result.output
    results = load(tmp_path / "results" / "hamlet" / "theirs.json")
    assert results.start == "none"
    assert results.method.config["image"] == "sha256:feed"
    assert results.method.config["minutes"] == 5
    assert not results.method.is_external
    assert results.summary.recall["0.25m_2deg"].value == pytest.approx(100 * 5 / 6)
    assert results.queries[-1].reason == "no line in poses.txt"
    assert "sha256:feed" in (state / "words").read_text().splitlines()
    # Nothing is left beside the results.
    assert {path.name for path in (tmp_path / "results").rglob("*")} == {
        "hamlet",
        "theirs.json",
        "album.h5",
    }


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("true", r"the container wrote no poses.txt: it must write /output/poses.txt"),
        ("echo 'no such model' >&2; exit 3", r"ended with exit status 3: no such model"),
        ("exit 3", r"ended with exit status 3: it printed no reason"),
        ("exit 137", r"was killed, as happens if it needs more than 16 GB: .*memory_gb"),
        ("echo 'docker: no space' >&2; exit 125", r"could not start the container: docker: no sp"),
        (
            'echo "a.jpg 1 0 0" > "$output/poses.txt"',
            r"^poses of the container: /output/poses",
        ),
        ('echo "a.jpg 1 0 0 0 0 0 nan" > "$output/poses.txt"', r"'nan' is not a finite number"),
        (
            'echo "a.jpg 1 0 0 0 0 0 0" > "$output/poses.txt"',
            r"a pose of a.jpg, which is not a query",
        ),
        ('yes "a.jpg 1 0 0 0 0 0 0" | head -7 > "$output/poses.txt"', r"7 poses, but hamlet has 6"),
        ('head -c 200000 /dev/zero > "$output/poses.txt"', r"has 200000 bytes"),
        ('ln -s /etc/passwd "$output/poses.txt"', r"is a link or a folder, not a file"),
        ('mkdir "$output/poses.txt"', r"is a link or a folder, not a file"),
        ('mkfifo "$output/poses.txt"', r"is a link or a folder, not a file"),
        (r'printf "\377\n" > "$output/poses.txt"', r"it is not a UTF-8 text file"),
    ],
)
def test_a_faulty_container_is_one_line(
    body: str,
    message: str,
    dataset: Dataset,
    state: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("BODY", body)
    with pytest.raises(InputError, match=message) as raised:
        container().evaluate(dataset, tmp_path / "results", NONE)
    assert len(str(raised.value).splitlines()) == 1
    assert str(tmp_path) not in str(raised.value)
    assert not (tmp_path / "results").exists()


def test_a_container_that_takes_too_long_is_killed(
    state: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The time is over once the container is at work, where it stays until it is killed."""
    monkeypatch.setenv("BODY", 'mkfifo "$STATE/never"; exec cat "$STATE/never"')

    class Started(subprocess.Popen[bytes]):
        def wait(self, timeout: float | None = None) -> int:
            while not (state / "never").exists():
                time.sleep(0.01)
            return super().wait(timeout)

    with monkeypatch.context() as patch:
        patch.setattr(subprocess, "Popen", Started)
        with pytest.raises(InputError, match=r"was stopped after 0.01 minutes: allow more"):
            run_container("sha256:feed", tmp_path, tmp_path, Limits(minutes=0.01))
    name = (state / "killed").read_text().strip()
    assert name in (state / "words").read_text().splitlines()


def test_a_flood_of_messages_does_not_stop_it(
    state: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flood = "head -c 3000000 /dev/zero | tr '\\0' 'x' >&2; echo >&2; echo 'the end' >&2; exit 1"
    monkeypatch.setenv("BODY", flood)
    with pytest.raises(InputError, match=r"exit status 1: the end$"):
        run_container("sha256:feed", tmp_path, tmp_path, Limits())


@pytest.mark.parametrize(
    ("script", "message"),
    [
        (None, "the command docker was not found"),
        ("echo 'Cannot connect to the Docker daemon' >&2; exit 1", "Cannot connect to the Docker"),
        (
            "echo 'Error: No such image: a' >&2; exit 1",
            "cannot use the image a .*No such image",
        ),
    ],
)
def test_docker_that_does_not_work_is_one_line(
    script: str | None, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bin").mkdir()
    if script is not None:
        (tmp_path / "bin" / "docker").write_text(f"#!/bin/sh\n{script}\n")
        (tmp_path / "bin" / "docker").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    with pytest.raises(InputError, match=message):
        Container("a", "theirs", Limits())


@pytest.mark.parametrize("image", ["", "--privileged", "a b", "a;b", "x" * 300, "-v"])
def test_a_word_that_is_no_image_is_refused(image: str) -> None:
    with pytest.raises(InputError, match="is not the name of an image"):
        Container(image, "theirs", Limits())


def test_names_and_options_that_cannot_be_used_are_refused(
    dataset: Dataset, state: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="sift is one of the project"):
        evaluate_container("a", "sift", {}, [dataset], tmp_path / "results")
    with pytest.raises(InputError, match="unknown key 'ratio'"):
        evaluate_container("a", "theirs", {"ratio": 1}, [dataset], tmp_path / "results")
    words = ["evaluate", str(tmp_path / "hamlet"), "--container", "a", "--method", "theirs"]
    words += ["--out", str(tmp_path / "results"), "--jobs", "2"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert "--container runs one --method, and takes neither" in result.output


def docker_answers() -> bool:
    return (
        shutil.which("docker") is not None
        and not subprocess.run(["docker", "info"], check=False, capture_output=True).returncode
    )


@pytest.mark.thorough
def test_a_real_container_is_isolated(dataset: Dataset, tmp_path: Path) -> None:
    if not docker_answers():
        pytest.skip("no Docker daemon answers")
    busybox = shutil.which("busybox")
    if busybox is None:
        pytest.skip("there is no static busybox to make an image of")
    # An image without a network: one program, which tries what it may not.
    script = (
        "#!/bin/busybox sh\n"
        "cd /data && touch x && exit 4; touch /x && exit 5\n"
        "busybox wget -T 2 http://192.0.2.1/ && exit 6\n"
        "busybox head -1 queries.txt | while read name rest; do\n"
        '  echo "$name 1 0 0 0 0 0 0" > /output/poses.txt; done\n'
    )
    shutil.copyfile(busybox, tmp_path / "busybox")
    (tmp_path / "run.sh").write_text(script)
    (tmp_path / "Dockerfile").write_text(
        "FROM scratch\nCOPY --chmod=755 busybox run.sh /bin/\n"
        'ENV PATH=/bin\nENTRYPOINT ["/bin/busybox", "sh", "/bin/run.sh"]\n'
    )
    image = "objconnect-test-container:1"
    subprocess.run(["docker", "build", "-q", "-t", image, str(tmp_path)], check=True)
    Container(image, "theirs", Limits(minutes=1)).evaluate(dataset, tmp_path / "r", NONE)
    assert load(tmp_path / "r" / "hamlet" / "theirs.json").queries[0].status == "ok"
