"""The examples run, in their order, on one small rendered scene."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import matplotlib.pyplot as plt
import pytest

from objconnect.scene.runtime.script import run_script
from simulate.render.libraries import require_libraries
from tests.blender import require_blender

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
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scene that 00_simulate.py renders and 01_map.py maps."""
    require_blender()
    require_libraries()
    path = tmp_path_factory.mktemp("examples") / "scene"
    load("00_simulate").main(path)
    load("01_map").main(path)
    return path


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


def test_a_scene_with_its_map(scene: Path) -> None:
    assert (scene / "scene.json").is_file()
    assert (scene / "map" / "points3D.bin").is_file()


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


@pytest.mark.usefixtures("figures")
def test_the_notebook(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its code cells run in order, as a notebook runs them."""
    monkeypatch.setenv("OBJCONNECT_SCENE", str(scene))
    notebook = json.loads((EXAMPLES / "map_query_error.ipynb").read_text(encoding="utf-8"))
    assert notebook["nbformat"] == 4
    names: dict[str, object] = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert not cell["outputs"]
            exec(compile("".join(cell["source"]), "map_query_error", "exec"), names)
    assert names["metres"] < 0.5  # type: ignore[operator]
    assert len(plt.get_fignums()) == 2


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem[:2])
def test_a_fault_of_the_user_is_one_line(path: Path, tmp_path: Path) -> None:
    if path.stem.startswith("07"):
        pytest.importorskip("pandas", exc_type=ImportError)
    if path.stem.startswith("00"):
        (tmp_path / "no").write_text("a file, where a folder is asked for")
    ended = subprocess.run(
        [sys.executable, str(path), "no/such/place"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(EXAMPLES.parent)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 2, ended.stderr
    assert ended.stderr.splitlines()[-1].startswith("error: ")
    assert "Traceback" not in ended.stderr


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
