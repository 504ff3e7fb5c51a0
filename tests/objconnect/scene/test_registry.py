"""A registry: names in order, entries that are imported late, and the faults of packages."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from objconnect.scene.errors import InputError
from objconnect.scene.registry import Lazy, Registry

Install = Callable[[str], None]


@pytest.fixture
def things() -> Registry[Callable[[str], object]]:
    return Registry(
        "thing",
        "objconnect.test_things",
        {"plain": str, "late": Lazy("fractions:Fraction", "a fraction")},
    )


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Puts a package's entry points where Python looks for installed packages."""
    monkeypatch.syspath_prepend(tmp_path)

    def install(lines: str) -> None:
        folder = tmp_path / "things-0.1.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: things\nVersion: 0.1\n")
        (folder / "entry_points.txt").write_text(f"[objconnect.test_things]\n{lines}\n")

    return install


def test_built_in_entries(things: Registry[Callable[[str], object]]) -> None:
    assert list(things) == ["plain", "late"]
    assert len(things) == 2
    assert things["plain"] is str
    assert things.load("late")("1/2") == 0.5
    assert things.summaries() == {"late": "a fraction"}
    assert "plain" in things
    assert "other" not in things


def test_an_entry_is_imported_when_it_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "this", raising=False)
    registry: Registry[Callable[[], None]] = Registry("x", "y", {"poem": Lazy("this:nothing")})
    assert list(registry) == ["poem"]
    assert "poem" in registry
    assert "this" not in sys.modules


def test_packages_come_after_the_built_in_entries(
    things: Registry[Callable[[str], object]], install: Install
) -> None:
    install("zebra = builtins:ascii\nfox = builtins:repr\nplain = builtins:int")
    assert list(things) == ["plain", "late", "fox", "zebra"]
    assert things.load("fox") is repr
    assert things.load("plain") is str  # what is built in wins


def test_unknown_names_are_refused(
    things: Registry[Callable[[str], object]], install: Install
) -> None:
    install("fox = builtins:repr")
    with pytest.raises(InputError, match="^unknown thing 'x': choose one of plain, late, fox$"):
        things.load("x")
    with pytest.raises(KeyError):
        things["x"]


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("nowhere:make", "ModuleNotFoundError: No module named 'nowhere'"),
        ("builtins:nothing", "AttributeError: .*'nothing'"),
        ("builtins:__name__", "builtins:__name__ is of type str"),
    ],
)
def test_an_entry_point_that_cannot_be_loaded_is_named_in_one_line(
    things: Registry[Callable[[str], object]], install: Install, value: str, message: str
) -> None:
    install(f"bad = {value}")
    with pytest.raises(InputError, match=rf"^thing 'bad' \({value}\) cannot be loaded: {message}$"):
        things.load("bad")


def test_faults_are_blamed_on_packages_alone(
    things: Registry[Callable[[str], object]], install: Install
) -> None:
    install("number = builtins:int")
    with (
        pytest.raises(InputError, match=r"^thing 'number' \(builtins:int\) cannot be read: ValueE"),
        things.convert_errors("number", "cannot be read"),
    ):
        things.load("number")("x")
    with (
        pytest.raises(InputError, match="^mine$"),
        things.convert_errors("number", "cannot be read"),
    ):
        raise InputError("mine")
    with pytest.raises(ValueError, match="Invalid literal"), things.convert_errors("late", "fails"):
        things.load("late")("x")
