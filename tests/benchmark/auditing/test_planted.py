"""Every planted fault is named, alone, and the clean originals have none."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from benchmark.auditing.command import audit
from benchmark.auditing.findings import Audit
from benchmark.auditing.matches import Pair, match_photographs
from benchmark.gate.scene import GATE_SCENES
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.storage.digests import sha256_of
from tests.benchmark.auditing.foreign import colmap, halve, nerfstudio, odm, table, tum

# Of projects that differ in one photograph, and of the two data sets of a real flight.
pytestmark = pytest.mark.usefixtures("extracted_once")

Plant = Callable[[Scene, Path], Path]


@pytest.fixture(autouse=True)
def _matched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The photographs of all projects are the same bytes: they are matched once."""

    def match(files: Sequence[Path], cameras: object, rows: Sequence[int]) -> list[Pair]:
        key = tuple(sha256_of(file) if file.is_file() else "" for file in files)
        if key not in MATCHED:
            MATCHED[key] = match_photographs(files, [None] * len(files), rows)
        return MATCHED[key]

    monkeypatch.setattr("benchmark.auditing.command.match_photographs", match)


MATCHED: dict[tuple[str, ...], list[Pair]] = {}


def run_audit(path: Path) -> Audit:
    (found,) = audit(path)
    return found


def xyzw(matrices: np.ndarray) -> np.ndarray:
    """Quaternions x y z w written where w x y z is expected."""
    poses = Pose.from_matrix(matrices)
    mixed = np.roll(poses.quaternion().numpy(), -1, axis=1)
    return Pose.from_quaternion(mixed, poses.translation).matrix().numpy()


def duplicate(scene: Scene, root: Path) -> Path:
    made = colmap(scene, root)
    shutil.copyfile(made / "images" / "000004.jpg", made / "images" / "000005.jpg")
    return made


def missing(scene: Scene, root: Path) -> Path:
    made = colmap(scene, root)
    (made / "images" / "000003.jpg").unlink()
    return made


def resize(scene: Scene, root: Path) -> Path:
    made = colmap(scene, root)
    halve(made / "images" / "000003.jpg")
    return made


def low_principal(matrices: list[np.ndarray], document: dict[str, object]) -> None:
    document["cx"] = float(str(document["cx"])) - 0.5
    document["cy"] = float(str(document["cy"])) - 0.5


def scale_to_feet(matrices: list[np.ndarray], document: dict[str, object]) -> None:
    for matrix in matrices:
        matrix[:3, 3] /= 0.3048


def two_swapped(matrices: list[np.ndarray], document: dict[str, object]) -> None:
    matrices[2], matrices[9] = matrices[9], matrices[2]


def shuffle(matrices: list[np.ndarray], document: dict[str, object]) -> None:
    matrices[:] = [matrices[k] for k in np.random.default_rng(3).permutation(len(matrices))]


PLANTED: dict[str, tuple[Plant, str]] = {
    "colmap-inverted": (lambda s, p: colmap(s, p, poses=np.linalg.inv), "poses-inverted"),
    "colmap-quaternion": (lambda s, p: colmap(s, p, poses=xyzw), "quaternion-order"),
    "colmap-keypoints": (lambda s, p: colmap(s, p, keypoints=-0.5), "half-pixel"),
    "colmap-focal": (lambda s, p: colmap(s, p, focal=1.08), "focal-length"),
    "colmap-duplicate": (duplicate, "duplicates"),
    "colmap-missing": (missing, "photographs-missing"),
    "colmap-resized": (resize, "sizes"),
    "nerfstudio-axes": (lambda s, p: nerfstudio(s, p, opengl=False), "axes-flipped"),
    "nerfstudio-principal": (lambda s, p: nerfstudio(s, p, low_principal), "half-pixel"),
    "nerfstudio-feet": (lambda s, p: nerfstudio(s, p, scale_to_feet), "scale"),
    "nerfstudio-swapped": (lambda s, p: nerfstudio(s, p, two_swapped), "names-swapped"),
    "nerfstudio-shuffled": (lambda s, p: nerfstudio(s, p, shuffle), "names-shuffled"),
    "tum-quaternion": (lambda s, p: tum(s, p, wxyz=True) / "trajectory.txt", "quaternion-order"),
    "tum-late": (lambda s, p: tum(s, p, late=1) / "trajectory.txt", "poses-shifted"),
    "odm-swapped": (lambda s, p: odm(s, p, swapped=True), "latlon-swapped"),
    "odm-height": (lambda s, p: odm(s, p, up=-47.6), "height-datum"),
    "table-swapped": (lambda s, p: table(s, p, lambda r: r[:, [1, 0, 2]]), "latlon-swapped"),
    "table-radians": (
        lambda s, p: table(s, p, lambda r: np.radians(r) * [1, 1, 0] + r * [0, 0, 1]),
        "latlon-radians",
    ),
    "table-height": (lambda s, p: table(s, p, lambda r: np.add(r, [0, 0, 47.6])), "height-datum"),
    "table-datum": (
        lambda s, p: table(s, p, lambda r: np.add(r, [1e-3, 0, 0])),
        "positions-offset",
    ),
}


def mark_thorough() -> Iterator[Any]:
    """Mark a fault thorough if files of another program have it, too."""
    seen: set[str] = set()
    for name, (_, fault) in PLANTED.items():
        yield pytest.param(name, marks=pytest.mark.thorough if fault in seen else ())
        seen.add(fault)


@pytest.mark.parametrize("name", mark_thorough())
def test_planted_fault_is_named(name: str, rendered: Scene, tmp_path: Path) -> None:
    plant, fault = PLANTED[name]
    found = run_audit(plant(rendered, tmp_path / "project"))
    assert found.faults == (fault,), found.text()


CLEAN: dict[str, Plant] = {
    "colmap": colmap,
    "nerfstudio": nerfstudio,
    "tum": lambda s, p: tum(s, p) / "trajectory.txt",
    "odm": odm,
    "table": table,
    "scene": lambda s, p: s.path,
}


@pytest.mark.parametrize("name", CLEAN)
def test_clean_originals_have_no_fault(name: str, rendered: Scene, tmp_path: Path) -> None:
    found = run_audit(CLEAN[name](rendered, tmp_path / "project"))
    assert found.ok, found.text()


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["brighton_beach", "caliterra"])
def test_real_flights_have_no_fault(
    name: str, flights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half the photographs are matched, two runs of neighbours."""
    monkeypatch.setattr("benchmark.auditing.command._MAX_MATCHED", 16)
    for found in audit(flights / name, out=tmp_path / "page.html"):
        assert found.ok, found.text()
    assert "<title>ObjConnect audit</title>" in (tmp_path / "page.html").read_text()


def test_pairs_on_which_opencv_fails_are_left_out(
    rendered: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It fails an assertion where no geometry fits the matches."""
    files = [rendered.images_root / name for name in rendered.frames("summer-noon-nadir-map").names]
    assert len(match_photographs(files[:2], [None, None], [0, 1])) == 1

    def fail(*_: object) -> None:
        raise cv2.error("(-215:Assertion failed)")

    monkeypatch.setattr("benchmark.auditing.matches.cv2.findFundamentalMat", fail)
    assert match_photographs(files[:2], [None, None], [0, 1]) == []


@pytest.mark.thorough
def test_a_flight_with_pairs_that_share_nothing_has_no_fault() -> None:
    """OpenCV fails on some pairs of the flight of the gate, whose winter hides what they share."""
    for found in audit(GATE_SCENES["gate"]):
        assert found.ok, found.text()
