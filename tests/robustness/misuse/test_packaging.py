"""What is installed works wherever it lies, and harms nobody it lies beside."""

from __future__ import annotations

import ast
import json
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmark.cli import app
from benchmark.gate.scene import GATE_SCENES
from objconnect.learning.training.config import TrainConfig
from objconnect.scene.config import SHIPPED_CONFIGS, list_configs, load_config
from objconnect.scene.errors import InputError
from simulate.config import SimulateConfig
from tests.robustness.misuse.built import (
    BOARD,
    PACKAGES,
    ROOT,
    Environment,
    build_wheel,
    install,
    source_tree,
)
from tests.test_imports import imports_when_loaded, list_loaded_with

pytestmark = pytest.mark.thorough

GATE = GATE_SCENES["gate"]
BASELINE = ROOT / "tests" / "data" / "gate-baseline"
ALL_ASKED = "| sift | same-flight | 10 | "  # as a leaderboard says it


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_wheel(tmp_path_factory.mktemp("wheel") / "source")


@pytest.fixture(scope="module")
def from_wheel(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Environment:
    return install(tmp_path_factory.mktemp("installed") / "venv", str(wheel))


@pytest.fixture(scope="module")
def editable(tmp_path_factory: pytest.TempPathFactory) -> Environment:
    folder = tmp_path_factory.mktemp("editable")
    return install(folder / "venv", "-e", str(source_tree(folder / "source")))


@pytest.fixture
def gate(tmp_path: Path) -> Path:
    """A copy of the gate's scene with one query in ten: what is tried is not recall."""
    copy = tmp_path / "data" / "gate"
    shutil.copytree(GATE, copy)
    for name in ("queries.txt", "reference_poses.txt", "priors.csv"):
        lines = (copy / name).read_text().splitlines(keepends=True)
        few = [line for line in lines if "query-" not in line or "0.jpg" in line]
        (copy / name).write_text("".join(few))
    return copy


# ------------------------------------------------------------------------ the wheel


def test_the_wheel_holds_every_file(wheel: Path) -> None:
    """Templates, weights and configurations too: whatever lies in our folders."""
    lie = {
        path.relative_to(ROOT).as_posix()
        for folder in PACKAGES
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    # Of the tracks, what was measured stays in the repository.
    lie = {name for name in lie if name.endswith(".py") or not name.startswith(f"{BOARD}/")}
    tracks = {
        path.relative_to(ROOT).as_posix()
        for pattern in ("*/track.yaml", "*/renders/*.json.xz")
        for path in (ROOT / BOARD).glob(pattern)
    }
    assert {
        "benchmark/tracks/uav-seasons/track.yaml",
        "benchmark/tracks/uav-small/renders/small-1.json.xz",
    } <= tracks
    lie |= tracks
    assert {"benchmark/report/templates/view.js", "baselines/pixloc/pixloc.safetensors"} <= lie
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert held == lie


def test_the_wheel_adds_four_names_and_the_command(wheel: Path, from_wheel: Environment) -> None:
    with zipfile.ZipFile(wheel) as archive:
        tops = {name.split("/")[0] for name in archive.namelist()}
    names = {top for top in tops if not top.endswith(".dist-info")}
    assert names == {"objconnect", "simulate", "baselines", "benchmark"}
    assert {path.name for path in from_wheel.ours.iterdir() if path.is_dir()} >= names
    answer = from_wheel.run([*from_wheel.script("objconnect"), "--version"], from_wheel.folder)
    assert answer.returncode == 0, answer.stderr


def test_the_wheel_works_outside_the_checkout(
    from_wheel: Environment, gate: Path, tmp_path: Path
) -> None:
    """The gate localized, scored and shown by what is installed alone."""
    objconnect = from_wheel.script("objconnect")

    def run(*words: str) -> str:
        answer = from_wheel.run([*objconnect, *words], tmp_path)
        assert answer.returncode == 0, answer.stderr
        return answer.stdout

    assert "evaluate" in run("--help")
    assert ALL_ASKED in run("evaluate", str(gate), "--method", "sift", "--out", "results")
    assert ALL_ASKED in run("leaderboard", "results", "--out", "board")
    assert "sift" in (tmp_path / "board" / "leaderboard.html").read_text()


def test_the_doctor_finds_the_weights_of_the_wheel(from_wheel: Environment, tmp_path: Path) -> None:
    answer = from_wheel.run([*from_wheel.script("objconnect"), "doctor", "--json"], tmp_path)
    checks = {check["name"]: check for check in json.loads(answer.stdout)["checks"]}
    assert str(from_wheel.ours) in checks["objconnect"]["found"]
    weights = {path.stem for p in PACKAGES for path in (ROOT / p).rglob("*.safetensors")}
    assert {f"weights {name}" for name in weights} <= set(checks)
    assert {checks[f"weights {name}"]["found"] for name in weights} == {"complete"}
    # Of the metadata: there is no pyproject.toml beside what is installed.
    assert checks["pycolmap"]["state"] == checks["torch"]["state"] == "ok"
    code = (
        "from objconnect.learning.checkpoint import read_weights\n"
        "from baselines.pixloc.localizer import SHIPPED\n"
        "read_weights(SHIPPED)"
    )
    answer = from_wheel.run([from_wheel.python, "-c", code], tmp_path)
    assert answer.returncode == 0, answer.stderr


# ------------------------------------------------------------------- configurations


@pytest.mark.parametrize("name", list_configs())
def test_a_configuration_is_found_by_its_name_from_anywhere(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file = list_configs()[name]
    model = SimulateConfig if "sessions:" in file.read_text() else TrainConfig
    by_name = load_config(model, Path(name), {})
    assert by_name == load_config(model, file, {})
    # A folder that is called so does not stand in the way; a file is what was meant.
    Path(name).mkdir(parents=True)
    assert load_config(model, Path(name), {}) == by_name
    Path(name).rmdir()
    Path(name).write_text("unheard_of: 1\n")
    with pytest.raises(InputError, match=f" key '.*' in {name}"):
        load_config(model, Path(name), {})


def test_an_unknown_name_lists_those_there_are() -> None:
    with pytest.raises(InputError, match="cannot read configuration demon: ") as caught:
        load_config(SimulateConfig, Path("demon"), {})
    assert str(caught.value).endswith(f"; shipped names are {', '.join(list_configs())}")
    assert {"demo", "uav-sim", "train/pixloc"} <= set(list_configs())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["simulate", "--config", "demo", "--preset", "nowhere", "--out", "out"],
            "bad value for 'preset' in {simulate}/demo.yaml: ",
        ),
        (
            ["train", "pixloc", "--config=train/pixloc", "--data=x", "--out=out", "--set=steps=no"],
            "bad value for 'steps' in {train}/pixloc.yaml: ",
        ),
        (
            ["simulate", "--config", "demon", "--out", "out"],
            "cannot read configuration demon: No such file or directory; shipped names are ",
        ),
    ],
)
def test_every_command_finds_configurations_by_name(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One fault each, found after the configuration was read: nothing is rendered or trained."""
    monkeypatch.chdir(tmp_path)
    answer = CliRunner().invoke(app, words)
    assert answer.exit_code == 2
    (line,) = answer.stderr.splitlines()
    assert said.format(simulate=SHIPPED_CONFIGS[""], train=SHIPPED_CONFIGS["train/"]) in line
    assert not list(tmp_path.iterdir())


def test_the_wheel_finds_configurations_by_name(from_wheel: Environment, tmp_path: Path) -> None:
    words = ["simulate", "--config", "demo", "--preset", "nowhere", "--out", "out"]
    answer = from_wheel.run([*from_wheel.script("objconnect"), *words], tmp_path)
    assert answer.returncode == 2
    demo = from_wheel.ours / "simulate" / "configs" / "demo.yaml"
    assert f"bad value for 'preset' in {demo}: " in answer.stderr


def test_the_wheel_finds_tracks_by_name(from_wheel: Environment, tmp_path: Path) -> None:
    words = ["track", "uav-seasons", "--place", "nowhere", "--out", "out"]
    answer = from_wheel.run([*from_wheel.script("objconnect"), *words], tmp_path)
    assert answer.returncode == 2
    assert "the track uav-seasons has no place 'nowhere'; it has town-1, " in answer.stderr


# ----------------------------------------------------------- the plugin of pytest


WORDS = ["-q", "-p", "no:cacheprovider"]
OWN_TESTS = """
from pathlib import Path

import benchmark.speed
import configs
import mapping
import scene


def test_its_packages_are_its_own():
    here = Path(__file__).parent
    for package in (scene, mapping, configs):
        assert Path(package.__file__).parent.parent == here
    assert benchmark.speed.FAST == scene.FAST


def test_recall(no_recall_drop):
    no_recall_drop(Path("results"), Path("baseline"))
"""


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """Somebody's repository: its packages are called like ours, and its recall is guarded."""
    folder = tmp_path / "theirs"
    for package in ("benchmark", "scene", "mapping", "configs"):
        (folder / package).mkdir(parents=True)
        (folder / package / "__init__.py").write_text("FAST = 300_000\n")
    (folder / "benchmark" / "speed.py").write_text("from scene import FAST\n")
    (folder / "pytest.ini").write_text("[pytest]\n")
    (folder / "test_own.py").write_text(OWN_TESTS)
    shutil.copytree(BASELINE, folder / "results")
    shutil.copytree(BASELINE, folder / "baseline")
    return folder


@pytest.mark.parametrize("kind", ["from_wheel", "editable"])
@pytest.mark.parametrize("way", ["python -m pytest", "pytest", "pytest with PYTHONPATH"])
def test_another_repository_with_packages_of_these_names(
    request: pytest.FixtureRequest, repository: Path, kind: str, way: str
) -> None:
    environment: Environment = request.getfixturevalue(kind)
    script = environment.folder / "bin" / "pytest"
    script.write_text("import pytest\nraise SystemExit(pytest.main())\n")
    command = [environment.python, *(["-m", "pytest"] if "-m" in way else [str(script)])]
    variables = {"PYTHONPATH": str(repository)} if "PYTHONPATH" in way else {}
    answer = environment.run([*command, *WORDS], repository, **variables)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    assert "2 passed" in answer.stdout


def test_a_baseline_that_is_missing_there_is_one_line(
    from_wheel: Environment, repository: Path
) -> None:
    shutil.rmtree(repository / "baseline")
    answer = from_wheel.run([from_wheel.python, "-m", "pytest", *WORDS], repository)
    assert answer.returncode == 1
    assert "FAILED test_own.py::test_recall - Failed: objconnect: error: " in answer.stdout
    assert "1 failed, 1 passed" in answer.stdout
    assert "Traceback" not in answer.stdout


def test_the_plugin_loads_nothing_of_ours_and_nothing_heavy() -> None:
    code = "import pytest, sys; before = set(sys.modules)\n"
    code += "import objconnect.pytest_plugin; print(*sorted(set(sys.modules) - before))"
    answer = subprocess.run(
        [sys.executable, "-c", code], check=True, cwd=ROOT, capture_output=True, text=True
    )
    loaded = answer.stdout.split()
    assert "objconnect.pytest_plugin" in loaded
    assert all(name.split(".")[0] == "objconnect" and len(name.split(".")) < 5 for name in loaded)


# --------------------------------------------------------------- other systems


def test_everything_but_rendering_imports_where_unix_is_not(gate: Path, tmp_path: Path) -> None:
    """In a process whose modules of ours see no module and no name that Unix alone has."""
    answer = subprocess.run(
        [
            sys.executable,
            "-m",
            "tests.robustness.misuse.not_unix",
            str(gate),
            str(tmp_path / "results"),
        ],
        check=False,
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert answer.returncode == 0, answer.stderr
    assert "Usage: " in answer.stdout
    assert ALL_ASKED in answer.stdout
    assert [path.name for path in (tmp_path / "results").iterdir()] == ["gate"]


# ------------------------------------------------------------ the doctor on old Pythons


def doctors_modules() -> list[str]:
    """What ``benchmark.doctor`` loads of ours, itself and the packages around it among them."""
    return sorted(list_loaded_with("benchmark.doctor"))


# What Python 3.10 and 3.11 brought, as far as a module may ask for it when it is loaded.
NEWER = {
    *("tomllib", "datetime.UTC", "enum.StrEnum", "itertools.pairwise", "types.NoneType"),
    *("typing.ParamSpec", "typing.Self", "typing.TypeAlias", "typing.assert_never"),
}


@pytest.mark.parametrize("name", doctors_modules())
def test_an_old_python_can_read_the_doctor(name: str) -> None:
    path = ROOT.joinpath(*name.split("."))
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    tree = ast.parse(file.read_text(encoding="utf-8"), name, feature_version=(3, 9))
    assert not imports_when_loaded(tree) & NEWER
    # Annotations such as "X | None" are evaluated by nobody.
    unions = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr)
    ]
    assert not unions or "__future__.annotations" in imports_when_loaded(tree)


def test_the_doctors_modules_are_found() -> None:
    known = {
        "benchmark",
        "benchmark.doctor",
        "simulate.render",
        "objconnect.scene.runtime.debian",
        "objconnect.scene.errors",
    }
    assert known <= set(doctors_modules())


def python_of(version: str) -> str:
    """A Python of this version: on the path, or of pyenv, whose stand-ins there may refuse."""
    found = Path.home().glob(f".pyenv/versions/{version}.*/bin/python")
    for path in filter(None, [shutil.which(f"python{version}"), *map(str, found)]):
        if subprocess.run([path, "-c", ""], check=False, capture_output=True).returncode == 0:
            return path
    pytest.skip(f"there is no Python {version} here")


@pytest.mark.parametrize("words", [["-m", "benchmark.doctor"], ["benchmark/doctor.py"]])
@pytest.mark.parametrize("version", ["3.9", "3.10"])
def test_an_old_python_is_told_so(version: str, words: list[str]) -> None:
    python = python_of(version)
    answer = subprocess.run([python, *words], check=False, cwd=ROOT, capture_output=True, text=True)
    assert (answer.returncode, answer.stderr) == (2, "")
    lines = answer.stdout.splitlines()
    assert lines[0].startswith(f"missing python  {version}.")
    assert lines[0].endswith("; 3.11 or newer is needed")
    assert "fix: install Python 3.11" in lines[1]
