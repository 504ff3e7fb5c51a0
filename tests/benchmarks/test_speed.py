"""Our pieces beside a peer or a bare lower bound, in one run: read the ratios, not the seconds.

``make bench``; the ordinary test run executes each once, to keep them working.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
import torch
from pytest_benchmark.fixture import BenchmarkFixture

from scene.bundle.scene import Scene
from scene.geometry.camera import Camera
from scene.maps.colmap_files import read_model
from scene.maps.matching import match

pytestmark = pytest.mark.thorough

CAMERA = Camera("OPENCV", 1024, 768, (869.0, 866.0, 526.0, 420.0, -0.4, 0.19, 1e-4, 6e-4))


@pytest.fixture(scope="module")
def points() -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    xy = torch.rand(100_000, 2, generator=generator, dtype=torch.float64) - 0.5
    return torch.cat([xy, torch.ones(100_000, 1, dtype=torch.float64)], -1) * 50


@pytest.mark.benchmark(group="project 100,000 points, OPENCV")
def test_project_ours(benchmark: BenchmarkFixture, points: torch.Tensor) -> None:
    assert benchmark(lambda: CAMERA.project(points).xy).shape == (100_000, 2)


@pytest.mark.benchmark(group="project 100,000 points, OPENCV")
def test_project_ours_with_jacobian(benchmark: BenchmarkFixture, points: torch.Tensor) -> None:
    assert benchmark(lambda: CAMERA.project(points, jacobian=True).jacobian).shape[-2:] == (2, 3)


@pytest.mark.benchmark(group="project 100,000 points, OPENCV")
def test_project_pycolmap(benchmark: BenchmarkFixture, points: torch.Tensor) -> None:
    native = pycolmap.Camera(model="OPENCV", width=1024, height=768, params=list(CAMERA.params))
    array = points.numpy()
    assert benchmark(lambda: native.img_from_cam(array)).shape == (100_000, 2)


@pytest.mark.benchmark(group="project 100,000 points, OPENCV")
def test_project_opencv(benchmark: BenchmarkFixture, points: torch.Tensor) -> None:
    array, zero = points.numpy(), np.zeros(3)
    distortion = np.array(CAMERA.distortion)
    K = CAMERA.calibration
    assert len(benchmark(lambda: cv2.projectPoints(array, zero, zero, K, distortion)[0])) == 100_000


@pytest.mark.benchmark(group="read a COLMAP model into arrays")
def test_read_ours(benchmark: BenchmarkFixture, rendered: Scene) -> None:
    assert len(benchmark(lambda: read_model(rendered.map_path)).images) == 12


@pytest.mark.benchmark(group="read a COLMAP model into arrays")
def test_read_pycolmap(benchmark: BenchmarkFixture, rendered: Scene) -> None:
    def read(path: Path) -> int:
        model = pycolmap.Reconstruction(path)
        np.array([point.xyz for point in model.points3D.values()])
        for image in model.images.values():
            np.array([point.xy for point in image.points2D])
            np.array([point.point3D_id for point in image.points2D])
        return int(model.num_images())

    assert benchmark(read, rendered.map_path) == 12


@pytest.fixture(scope="module")
def descriptors() -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.nn.functional.normalize(torch.rand(2, 3000, 128, generator=generator), dim=-1)


@pytest.mark.benchmark(group="match 3,000 descriptors to 3,000")
def test_match_ours(benchmark: BenchmarkFixture, descriptors: torch.Tensor) -> None:
    assert benchmark(match, descriptors[0], descriptors[1], 0.8).shape[1] == 2


@pytest.mark.benchmark(group="match 3,000 descriptors to 3,000")
def test_match_opencv(benchmark: BenchmarkFixture, descriptors: torch.Tensor) -> None:
    a, b = descriptors.numpy()
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    benchmark(lambda: (matcher.knnMatch(a, b, 2), matcher.knnMatch(b, a, 2)))


@pytest.mark.benchmark(group="match 3,000 descriptors to 3,000")
def test_match_bare_product(benchmark: BenchmarkFixture, descriptors: torch.Tensor) -> None:
    """The matrix product alone: nothing that looks at every pair can be faster."""
    benchmark(lambda: descriptors[0] @ descriptors[1].T)
