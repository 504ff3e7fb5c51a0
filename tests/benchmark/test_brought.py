"""Localizers of other packages: the example of the documentation, and faulty ones."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmark.datasets.open import open_datasets
from benchmark.evaluation.evaluate import evaluate
from objconnect.methods import create, method_names
from objconnect.scene.errors import InputError

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "nearest"

Install = Callable[[str, str], None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Puts a localizer's entry point where Python looks for installed packages."""
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(site)

    def install(name: str, value: str) -> None:
        folder = site / f"{name}-0.1.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1\n")
        (folder / "entry_points.txt").write_text(f"[objconnect.localizers]\n{name} = {value}\n")

    shutil.copy(EXAMPLE / "nearest.py", site)
    return install


def test_the_example_runs_as_it_stands(install: Install, made_flight: Path, tmp_path: Path) -> None:
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]
    for name, value in project["entry-points"]["objconnect.localizers"].items():
        install(name, value)
    assert "nearest" in method_names()
    (dataset,) = open_datasets(made_flight)
    results = evaluate(dataset, create("nearest", {"ignore_altitude": False}), tmp_path / "out")
    assert results.method.config == {"ignore_altitude": False}
    # The queries lie halfway between photographs of the map, 4 m from either.
    assert [query.t_err_m for query in results.queries] == [pytest.approx(4)] * 3
    with pytest.raises(InputError, match="unknown key"):
        create("nearest", {"altitude": 1})
    assert len((EXAMPLE / "nearest.py").read_text().splitlines()) <= 42


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("nowhere:make", "ModuleNotFoundError"),
        ("nearest:forge", "AttributeError"),
        ("builtins:dict", "it lacks name, config, weights_sha256, prepare, localize"),
        ("builtins:int", "TypeError"),
    ],
)
def test_faulty_packages_are_named(install: Install, value: str, message: str) -> None:
    install("faulty", value)
    with pytest.raises(InputError, match=message):
        create("faulty", {})


def test_an_unknown_name_lists_the_known_ones(install: Install) -> None:
    install("nearest", "nearest:make")
    with pytest.raises(
        InputError,
        match="unknown method 'oracle'; known: sift, orb, akaze, epipolar, d2net, "
        r"aliked\+lightglue, disk\+lightglue, pixloc, pixloc-search, objconnect, place, prior, "
        "nearest",
    ):
        create("oracle", {})
