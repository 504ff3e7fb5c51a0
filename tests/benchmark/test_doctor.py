"""The doctor reports what is missing."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmark import doctor
from benchmark.cli import app
from benchmark.doctor import Check, Diagnosis

ROOT = Path(__file__).parents[2]


def checks(diagnosis: Diagnosis) -> dict[str, Check]:
    return {check.name: check for check in diagnosis.checks}


@pytest.fixture
def loads(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Everything loads but what is named, without the seconds that takes."""

    def all_but(*broken: str) -> None:
        def load(module: str) -> doctor._Loaded:
            error = f"ImportError: no {module}" if module in broken else ""
            return doctor._Loaded("[]" if module == "torch" and not error else "", error)

        monkeypatch.setattr(doctor, "_load", load)

    all_but()
    return all_but


def without(monkeypatch: pytest.MonkeyPatch, *packages: str) -> None:
    """Take packages from the list of those installed."""
    known = doctor._version
    monkeypatch.setattr(doctor, "_version", lambda p: None if p in packages else known(p))


@pytest.mark.thorough
def test_a_library_that_does_not_load_and_no_network(tmp_path: Path) -> None:
    """Really: in processes where h5py is broken, the command line cannot start for want of typer,
    and whoever connects to anything ends at once."""
    (tmp_path / "h5py.py").write_text("raise ImportError('libhdf5.so.310: cannot open')\n")
    (tmp_path / "typer.py").write_text("raise ImportError('no typer here')\n")
    (tmp_path / "sitecustomize.py").write_text(
        "import os, socket\nsocket.socket.connect = lambda *_: os._exit(99)\n"
    )
    path = os.pathsep.join([str(tmp_path), str(ROOT)])
    answer = subprocess.run(
        [sys.executable, "-m", "benchmark.doctor"],
        check=False,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
    )
    assert answer.returncode == 2, answer.stderr
    assert answer.stderr == ""
    lines = answer.stdout.splitlines()
    (at,) = (k for k, line in enumerate(lines) if line.startswith("missing") and "h5py" in line)
    assert "cannot be loaded: ImportError: libhdf5.so.310: cannot open" in lines[at]
    assert f"fix: {sys.executable} -m pip install 'h5py>=" in lines[at + 1]
    assert any(line.startswith("missing typer") for line in lines)
    assert any(line.startswith("ok") and " numpy " in line for line in lines)
    assert lines[-1] == "requirements not met: 2"


def test_doctor_prints_json_and_exits_with_2(loads: Callable[..., None]) -> None:
    answer = CliRunner().invoke(app, ["doctor", "--json"])
    assert answer.exit_code == 0, answer.output
    assert json.loads(answer.stdout)["ok"] is True
    loads("torch", "cv2")
    answer = CliRunner().invoke(app, ["doctor", "--json"])
    assert answer.exit_code == 2
    said = json.loads(answer.stdout)
    assert said["ok"] is False
    missing = [check["name"] for check in said["checks"] if check["state"] == "missing"]
    assert missing == ["torch", "opencv-python-headless"]


def test_a_missing_package_is_named(
    loads: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    loads("pycolmap")
    without(monkeypatch, "pycolmap")
    found = checks(doctor.doctor())["pycolmap"]
    assert (found.state, found.found) == ("missing", "not installed, >=4.2,<4.3 is needed")
    assert found.fix == f"{sys.executable} -m pip install 'pycolmap>=4.2,<4.3'"


def test_a_package_of_another_version_is_named(
    loads: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    known = doctor._version
    monkeypatch.setattr(doctor, "_version", lambda p: "2.1.3" if p == "numpy" else known(p))
    monkeypatch.setattr(doctor, "missing_packages", list)
    found = checks(doctor.doctor())
    assert found["numpy"].state == "ok"
    if "numpy for simulate" in found:
        assert found["numpy for simulate"].found == "2.1.3 is not >=1.26,<2"


def test_libraries_of_rendering_are_optional_without_bpy(
    loads: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    without(monkeypatch, "bpy", "pytest", "ray")
    monkeypatch.setattr(doctor, "missing_packages", lambda: ["libxi6"])
    monkeypatch.setattr(shutil, "which", lambda name: None)
    diagnosis = doctor.doctor()
    found = checks(diagnosis)
    assert diagnosis.ok
    assert found["bpy"].state == "absent"
    assert "objconnect[simulate]" in found["bpy"].fix
    assert found["ray"].state == "absent"
    assert "objconnect[cluster]" in found["ray"].fix
    assert "ray for cluster" not in found
    assert found["Blender's libraries"].state == "absent"
    assert found["Blender's libraries"].fix == "sudo apt-get install -y libxi6"
    assert found["Chromium"].fix == "sudo apt-get install -y chromium"
    assert "pytest>=" in found["tests"].fix


def test_libraries_of_rendering_are_required_with_bpy(
    loads: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    known = doctor._version
    monkeypatch.setattr(doctor, "_version", lambda p: "4.5.1" if p == "bpy" else known(p))
    monkeypatch.setattr(doctor, "missing_packages", lambda: ["libxi6"])
    assert checks(doctor.doctor())["Blender's libraries"].state == "missing"
    loads("bpy")
    assert checks(doctor.doctor())["bpy for simulate"].fix == "sudo apt-get install -y libxi6"


def test_damaged_or_missing_weights_are_named(tmp_path: Path) -> None:
    folder = tmp_path / "weights"
    folder.mkdir()
    for package in doctor._WITH_WEIGHTS:
        for kind in ("*.md", "*.safetensors"):
            for path in (ROOT / package).rglob(kind):
                shutil.copy(path, folder)
    assert all(check.state == "ok" for check in doctor._weights([folder]))
    whole = folder / "d2net.safetensors"
    data = whole.read_bytes()
    for content, said in ((data[:-1], "cut short"), (b"{}", "damaged"), (b"", "damaged")):
        whole.write_bytes(content)
        found = checks(Diagnosis(tuple(doctor._weights([folder]))))
        assert said in found["weights d2net"].found
        assert found["weights pixloc"].state == "ok"
    whole.unlink()
    assert "No such file" in next(iter(doctor._weights([folder]))).found
    shutil.rmtree(folder)
    (gone,) = doctor._weights([folder])
    assert gone.state == "missing"


def test_a_full_disk_is_named(loads: Callable[..., None], monkeypatch: pytest.MonkeyPatch) -> None:
    usage = shutil.disk_usage(ROOT)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=10))
    found = checks(doctor.doctor())
    assert found["disk here"].state == found["disk temporary"].state == "missing"


def test_requirements_are_those_of_the_project() -> None:
    found = {(r.package, r.extra): r for r in doctor._requirements()}
    assert found["pycolmap", ""].versions == ">=4.2,<4.3"
    assert found["bpy", "simulate"].module == "bpy"
    assert found["opencv-python-headless", ""].module == "cv2"
    text = 'numpy<2,>=1.26; extra == "simulate"'  # as an installed package says it
    assert doctor._requirement(text, "simulate") == ("numpy", "<2,>=1.26", "simulate")


@pytest.mark.parametrize(
    ("version", "wanted", "fits"),
    [
        ("2.6.0+cpu", ">=2.6", True),
        ("2.5.9", ">=2.6", False),
        ("2.0.0", ">=1.26,<2", False),
        ("1.26.4", "<2,>=1.26", True),
        ("4.10.0.84", ">=4.10", True),
        ("3.0rc1", ">=2.8", True),
        ("1", "", True),
    ],
)
def test_versions_are_compared_by_number(version: str, wanted: str, fits: bool) -> None:
    assert doctor._fits(version, wanted) is fits
