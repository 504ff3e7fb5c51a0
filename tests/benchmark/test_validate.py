"""Flights whose reference poses or cameras are written by other conventions are named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmark.validation import validate
from objconnect.scene.geometry.pose import Pose

pytestmark = pytest.mark.usefixtures("extracted_once")


@pytest.fixture
def sparse(flight_copy: Path) -> Path:
    """The hard split alone: it has few photographs, so that the test is quick."""
    return flight_copy.with_name(f"{flight_copy.name}-sparse")


def rewrite_poses(flight: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    path = flight / "reference_poses_sparse.txt"
    lines = []
    for line in path.read_text().splitlines():
        if line.startswith("#"):
            continue
        name, *numbers = line.split()
        values = np.array(numbers, float)
        pose = Pose.from_matrix(
            change(Pose.from_quaternion(values[:4], values[4:]).matrix().numpy())
        )
        written = [*pose.quaternion().tolist(), *pose.translation.tolist()]
        lines.append(" ".join([name, *map(repr, written)]))
    path.write_text("\n".join(lines) + "\n")


def transpose(matrix: np.ndarray) -> np.ndarray:
    matrix[:3, :3] = matrix[:3, :3].T.copy()
    return matrix


def centre(matrix: np.ndarray) -> np.ndarray:
    matrix[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return matrix


def test_a_real_flight_passes(sparse: Path, cache: Path) -> None:
    report = validate(sparse, cache)
    assert report.ok, report.text()
    poses = next(check for check in report.checks if "photographs" in check.name)
    assert poses.figures["median_m"] < 0.5


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (np.linalg.inv, "poses are inverted"),
        *(
            pytest.param(*convention, marks=pytest.mark.thorough)
            for convention in (
                (centre, "translations are camera centres"),
                (transpose, "rotations are transposed"),
                (lambda matrix: np.diag([1.0, -1, -1, 1]) @ matrix, "camera axes are OpenGL's"),
            )
        ),
    ],
)
def test_other_conventions_of_reference_poses_are_named(
    flight_copy: Path,
    sparse: Path,
    cache: Path,
    change: Callable[[np.ndarray], np.ndarray],
    fault: str,
) -> None:
    rewrite_poses(flight_copy, change)
    report = validate(sparse, cache)
    assert not report.ok
    assert fault in report.text()


@pytest.mark.thorough
def test_query_cameras_off_by_half_a_pixel_are_named(
    flight_copy: Path, sparse: Path, cache: Path
) -> None:
    path = flight_copy / "queries_sparse.txt"
    text = path.read_text()
    path.write_text(text.replace("512.000000 288.000000", "511.500000 287.500000"))
    assert text != path.read_text()
    report = validate(sparse, cache)
    assert not report.ok
    assert "half a pixel too small" in report.text()
