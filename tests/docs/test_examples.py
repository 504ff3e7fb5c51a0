"""The examples run, in their order, on one small rendered scene."""

from __future__ import annotations

import importlib.util
import json
import runpy
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import matplotlib.pyplot as plt
import pytest

from objconnect.scene.bundle.scene import Scene
from objconnect.scene.runtime.script import run_script
from simulate.config import SimulateConfig
from simulate.render.libraries import require_libraries
from tests.blender import require_blender

pytestmark = pytest.mark.usefixtures("extracted_once")

EXAMPLES = Path(__file__).parents[2] / "examples"
MOST_LINES = 60


def load(name: str) -> ModuleType:
    """Load an example as a module."""
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def scene(rendered: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene with its map as the first two examples make one."""
    return Path(shutil.copytree(rendered.path, tmp_path_factory.mktemp("examples") / "scene"))


@pytest.fixture(scope="module")
def results(scene: Path) -> Path:
    """Results of two methods, by 05_compare_two_methods.py."""
    load("05_compare_two_methods").main(scene, scene.parent / "results", scene.parent / "board")
    return scene.parent / "results"


def test_every_example_is_short_and_tested() -> None:
    tested = Path(__file__).read_text(encoding="utf-8")
    names = sorted(path.stem for path in EXAMPLES.glob("*.py"))
    assert [name[:2] for name in names] == [f"{k:02}" for k in range(8)]
    for name in names:
        assert f'load("{name}").main(' in tested
        assert len((EXAMPLES / f"{name}.py").read_text(encoding="utf-8").splitlines()) < MOST_LINES


def test_the_page_includes_every_example() -> None:
    page = (EXAMPLES.parent / "docs" / "examples.md").read_text(encoding="utf-8")
    for path in EXAMPLES.glob("*.py"):
        assert f'--8<-- "examples/{path.name}"' in page


def test_a_scene_is_asked_for(
    scene: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without the rendering: the configuration is one, and what was rendered is read."""
    asked: list[SimulateConfig] = []

    def rendered_before(config: SimulateConfig, out: Path) -> Scene:
        asked.append(config)
        return Scene.open(out)

    monkeypatch.setattr("simulate.simulate", rendered_before)
    load("00_simulate").main(scene)
    assert [session.role for session in asked[0].sessions] == ["map", "query", "query"]
    assert "summer-noon-nadir-map: 12 frames" in capsys.readouterr().out


@pytest.mark.thorough
def test_a_scene_with_its_map(tmp_path: Path) -> None:
    require_blender()
    require_libraries()
    load("00_simulate").main(tmp_path)
    load("01_map").main(tmp_path)
    assert (tmp_path / "scene.json").is_file()
    assert (tmp_path / "map" / "points3D.bin").is_file()


def test_a_map_is_read(
    scene: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without the building."""
    built = SimpleNamespace(text=lambda: "built")
    monkeypatch.setattr("objconnect.build_map", lambda path: built)
    load("01_map").main(scene)
    said = capsys.readouterr().out
    assert said.startswith("built") and "12 photographs" in said


def test_one_image_is_found(scene: Path) -> None:
    assert load("02_localize_one_image").main(scene) < 0.5


def test_own_photographs(scene: Path, tmp_path: Path) -> None:
    photographs = scene / "sessions" / "summer-noon-nadir-map" / "images"
    load("03_bring_your_own_photographs").main(photographs, tmp_path / "own")
    assert (tmp_path / "own" / "map" / "points3D.bin").is_file()


def test_a_localizer_of_your_own(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    load("04_write_a_localizer").main(scene, tmp_path)
    assert "0.5m_5deg" in capsys.readouterr().out


def test_two_methods_compared(results: Path) -> None:
    assert len(list(results.rglob("*.json"))) == 2
    assert (results.parent / "board" / "leaderboard.html").is_file()


def test_training(scene: Path, tmp_path: Path) -> None:
    load("06_train").main(scene, tmp_path / "run")
    assert (tmp_path / "run" / "weights.safetensors").is_file()


def test_results_in_pandas(results: Path) -> None:
    why = "pandas is not installed, or needs another numpy (the extra [docs] brings it)"
    pytest.importorskip("pandas", reason=why, exc_type=ImportError)
    table = load("07_results_in_pandas").main(results)
    assert set(table.method) == {"sift", "pixloc"}
    assert table.found[table.condition == "summer-noon"].any()


@pytest.fixture
def figures() -> Iterator[None]:
    """Figures are drawn without a screen, and closed afterwards."""
    backend = plt.get_backend()
    plt.switch_backend("agg")
    yield
    plt.close("all")
    plt.switch_backend(backend)


def run_notebook(name: str) -> dict[str, Any]:
    """Run the code cells in order, as a notebook runs them, and return their variables."""
    notebook = json.loads((EXAMPLES / f"{name}.ipynb").read_text(encoding="utf-8"))
    assert notebook["nbformat"] == 4
    names: dict[str, Any] = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert not cell["outputs"]
            exec(compile("".join(cell["source"]), name, "exec"), names)
    return names


@pytest.mark.usefixtures("figures")
def test_the_notebook_of_a_scene(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OBJCONNECT_SCENE", str(scene))
    assert run_notebook("map_query_error")["metres"] < 0.5
    assert len(plt.get_fignums()) == 2


@pytest.mark.usefixtures("figures")
def test_the_notebook_of_a_published_sample(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without Blender, on the sample that the notebook publishes."""
    monkeypatch.setitem(sys.modules, "bpy", None)
    monkeypatch.delenv("OBJCONNECT_SAMPLE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    assert run_notebook("published_sample")["metres"] < 0.5
    assert len(plt.get_fignums()) == 2
    files = (path for path in (tmp_path / "sample").rglob("*") if path.is_file())
    assert sum(path.stat().st_size for path in files) < 20e6


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem[:2])
def test_a_fault_of_the_user_is_one_line(
    path: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if path.stem.startswith("07"):
        pytest.importorskip("pandas", exc_type=ImportError)
    if path.stem.startswith("00"):
        (tmp_path / "no").write_text("a file, where a folder is asked for")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(path), "no/such/place"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(path), run_name="__main__")
    assert ended.value.code == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith("error: ")


def test_scripts_say_which_paths_they_take(capsys: pytest.CaptureFixture[str]) -> None:
    def main(scene: Path, out: Path = Path("out")) -> None:
        raise OSError(28, "No space left on device", str(out))

    for words in ([], ["a", "b", "c"]):
        with pytest.raises(SystemExit) as ended:
            run_script(main, words)
        assert ended.value.code == 2
        assert "give SCENE, OUT, in this order" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        run_script(main, ["a"])
    assert ended.value.code == 2
    assert capsys.readouterr().err == "error: [Errno 28] No space left on device: 'out'\n"
