from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest
from pydantic import Field, ValidationError

from objconnect.scene.config import Config, load_config, take_recorded
from objconnect.scene.errors import InputError


class Nested(Config):
    depth: int = Field(1, ge=0)


class Options(Config):
    ratio: float = Field(0.8, gt=0, le=1)
    name: str = "sift"
    inner: Nested = Nested()


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "config.yaml"
    path.write_text(text)
    return path


def test_defaults() -> None:
    assert load_config(Options, None, {}) == Options()


def test_file_then_overrides(tmp_path: Path) -> None:
    path = write(tmp_path, "ratio: 0.5\nname: orb\ninner: {depth: 3}\n")
    options = load_config(Options, path, {"name": "brief"})
    assert options == Options(ratio=0.5, name="brief", inner=Nested(depth=3))


def test_an_override_may_be_none() -> None:
    class Searching(Config):
        radius: float | None = 3.0

    assert load_config(Searching, None, {"radius": None}).radius is None
    with pytest.raises(InputError, match="ratio"):
        load_config(Options, None, {"ratio": None})


def test_an_empty_file_means_defaults(tmp_path: Path) -> None:
    assert load_config(Options, write(tmp_path, "# nothing yet\n"), {}) == Options()


def test_a_configuration_cannot_change() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        Options().ratio = 0.1  # type: ignore[misc]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ration: 0.5", "unknown key 'ration' in .*config.yaml; known: ratio, name, inner"),
        ("inner: {deep: 3}", "unknown key 'inner.deep' in .*config.yaml; known: depth"),
        ("ratio: 2", r"bad value for 'ratio' in .*config.yaml: .*less than or equal to 1 \(got 2"),
        ("ratio: much", "bad value for 'ratio' in .*config.yaml"),
        ("inner: {depth: -1}", "bad value for 'inner.depth' in .*config.yaml"),
        ("7: seven", "'7' in .*config.yaml"),
        ("ratio: [1, 2", "config.yaml is not valid YAML"),
        ("ratio: 2001-99-99", "config.yaml is not valid YAML"),
        ("? [1, 2]\n: 3", "config.yaml is not valid YAML"),
        ("ratio: 0.5\nratio: 0.6", "the key 'ratio' is given twice"),
        ("ratio: " + "[" * 1000, "config.yaml is not valid YAML"),
        ("- ratio\n- name", "must hold 'key: value' lines, not a list"),
        ("ratio", "must hold 'key: value' lines, not a str"),
    ],
)
def test_faults_are_one_line_that_names_the_key(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        load_config(Options, write(tmp_path, text), {})
    assert "\n" not in str(caught.value)


def test_a_fault_on_the_command_line_says_so(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown key 'speed' on the command line"):
        load_config(Options, None, {"speed": 3})


def test_an_unreadable_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read configuration .*missing.yaml: No such file"):
        load_config(Options, tmp_path / "missing.yaml", {})


class Strict(Config):
    table: dict[str, str]
    seed: int


def test_a_missing_key_is_named_without_the_rest_of_the_file(tmp_path: Path) -> None:
    table = "\n".join(f"  file{k}: digest" for k in range(1000))
    with pytest.raises(InputError) as caught:
        load_config(Strict, write(tmp_path, f"table:\n{table}\n"), {})
    assert str(caught.value) == f"missing key 'seed' in {tmp_path / 'config.yaml'}"


def test_a_large_bad_value_is_shortened(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="bad value for 'seed'") as caught:
        load_config(Strict, write(tmp_path, f"table: {{}}\nseed: {'x' * 10_000}\n"), {})
    assert len(str(caught.value)) < 400


def test_dotted_overrides_change_nested_values_alone(tmp_path: Path) -> None:
    class Outer(Config):
        ratio: float = 0.8
        options: Options = Options()

    path = write(tmp_path, "options: {ratio: 0.5, name: orb}\n")
    changed = load_config(Outer, path, {"options.inner.depth": 3, "options.name": "brief"})
    assert changed.options == Options(ratio=0.5, name="brief", inner=Nested(depth=3))
    with pytest.raises(InputError, match=r"unknown key 'options\.depth' .*known: ratio, name"):
        load_config(Outer, None, {"options.depth": 3})
    with pytest.raises(InputError, match="bad value for 'ratio'"):
        load_config(Outer, None, {"ratio.depth": 3})


def test_what_an_earlier_version_recorded_is_read() -> None:
    """Constants are left out; a dissolved group gives its fields to what held it."""

    class Inner(Config):
        near: float = 1.0

    class Outer(Config):
        inner: Inner = Inner()
        control_sigma_m: float = 0.05
        nearest: int = 12
        table: Mapping[str, int] = Field(default_factory=dict)

    recorded = {
        "inner": {"near": 2.0, "gone": 1},
        "control": {"sigma_m": 0.02, "wrong_m": 1.0},
        "pairs": {"nearest": 5, "blind": 10, "deeper": {"gone": 1}},
        "gone": [1, 2],
        "table": {"kept": 1},
    }
    options = take_recorded(Outer, recorded)
    assert Outer.model_validate(options) == Outer(
        inner=Inner(near=2.0), control_sigma_m=0.02, nearest=5, table={"kept": 1}
    )
    assert take_recorded(Outer, options) == options
