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

import objconnect.localization.align.linearise as linearising
from objconnect.learning.inference import fuse_layers
from objconnect.learning.quantization import largest_values, quantize
from objconnect.localization.align.residuals import Level, LevelCost
from objconnect.localization.align.sampling import CellTable, stencil
from objconnect.localization.depth.grey_photograph import GreyPhotograph
from objconnect.localization.depth.sweep import window_offsets
from objconnect.localization.depth.window_sweep import WindowSweep
from objconnect.localization.featuremetric.quantized import channel_scales
from objconnect.network.localizer import SHIPPED
from objconnect.network.network import read_network
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.matching import match

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


@pytest.fixture(scope="module")
def looked_up() -> tuple[CellTable, torch.Tensor, torch.Tensor]:
    """Return a level of 128 channels, and cells and weights of 2,048 points in it."""
    generator = torch.Generator().manual_seed(0)
    maps = torch.rand(1, 128, 180, 180, generator=generator).contiguous(
        memory_format=torch.channels_last
    )
    table = CellTable.of(maps)
    cells = 2 + 170 * torch.rand(1, 2048, 2, generator=generator)
    return table, *stencil(cells, table, torch.zeros(1, dtype=torch.long))


@pytest.mark.benchmark(group="value and slopes of 2,048 points, 128 channels")
def test_mix_ours(
    benchmark: BenchmarkFixture, looked_up: tuple[CellTable, torch.Tensor, torch.Tensor]
) -> None:
    table, index, weights = looked_up
    assert benchmark(table.value_and_slopes, index, weights).shape == (1, 2048, 3, 128)


@pytest.mark.benchmark(group="value and slopes of 2,048 points, 128 channels")
def test_mix_by_products(
    benchmark: BenchmarkFixture, looked_up: tuple[CellTable, torch.Tensor, torch.Tensor]
) -> None:
    """The cells of every point copied side by side, then one small product a point."""
    table, index, weights = looked_up
    parts = torch.nn.functional.one_hot(torch.tensor([0] * 4 + [1] * 8 + [2] * 8)).T
    each = weights[..., None, :] * parts
    mixed = benchmark(lambda: each @ table.gather(index))
    torch.testing.assert_close(mixed, table.value_and_slopes(index, weights))


@pytest.mark.benchmark(group="value and slopes of 2,048 points, 128 channels")
def test_mix_bare_lookup(
    benchmark: BenchmarkFixture, looked_up: tuple[CellTable, torch.Tensor, torch.Tensor]
) -> None:
    """The cells copied once, each of them only for one of the sums."""
    table, index, _ = looked_up
    benchmark(lambda: table.values.index_select(0, index[..., 4:16].flatten()))


@pytest.mark.benchmark(group="the cost of a pose around 2,048 points, 32 channels")
@pytest.mark.parametrize("way", ["compiled", "by_torch"])
def test_linearise(benchmark: BenchmarkFixture, way: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """In compiled loops, and by operations of torch."""
    monkeypatch.setattr(linearising, "supports_loops", lambda device: way == "compiled")
    generator = torch.Generator().manual_seed(0)
    maps = torch.rand(1, 32, 256, 256, generator=generator).contiguous(
        memory_format=torch.channels_last
    )
    aside = 130 * (torch.rand(1, 2048, 2, generator=generator) - 0.5)
    points = torch.cat([aside, torch.full((1, 2048, 1), 80.0)], -1)
    level = Level(maps, 2.0, torch.rand(1, 2048, 32, generator=generator))
    camera = Camera("PINHOLE", 512, 512, (400.0, 400.0, 256.0, 256.0)).intrinsics(torch.float32)
    usable = torch.ones(1, 2048, dtype=torch.bool)
    pose = Pose(torch.eye(3, dtype=torch.float64)[None], torch.zeros(1, 3, dtype=torch.float64))
    with torch.inference_mode():
        cost = LevelCost.of(level, points, usable, camera, 1.0, 0.3)
        linearising.linearise(cost, pose)  # compiled now, not in the first round
        assert float(benchmark(linearising.linearise, cost, pose).seen.float().mean()) > 0.5


@pytest.fixture(scope="module")
def photographs() -> tuple[GreyPhotograph, GreyPhotograph, torch.Tensor]:
    """Return two photographs of 512 pixels from 80 m, 20 m apart, and 2,000 pixels of the first."""
    generator = torch.Generator().manual_seed(0)
    camera = Camera("PINHOLE", 512, 512, (512.0, 512.0, 256.0, 256.0))
    down = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))

    def take_photograph(x: float) -> GreyPhotograph:
        centre = torch.tensor([x, 0.0, 80.0], dtype=torch.float64)
        grey = 255 * torch.rand(512, 512, generator=generator)
        return GreyPhotograph(grey, camera, Pose(down, -down @ centre), lambda xy: xy)

    xy = 150 + 300 * torch.rand(2000, 2, generator=generator, dtype=torch.float64)
    return take_photograph(0.0), take_photograph(20.0), xy


@pytest.mark.benchmark(group="correlate 2,000 windows of 49 values at 11 depths")
def test_windows_ours(
    benchmark: BenchmarkFixture, photographs: tuple[GreyPhotograph, GreyPhotograph, torch.Tensor]
) -> None:
    here, other, xy = photographs
    sweep = WindowSweep(here, xy, window_offsets(), 8.0)
    depths = torch.linspace(1 / 85, 1 / 75, 11).expand(2000, -1)
    found = benchmark(sweep, depths, other)
    assert found.shape == (2000, 11) and (found > -1).mean() > 0.5


@pytest.mark.benchmark(group="correlate 2,000 windows of 49 values at 11 depths")
def test_windows_bare_lookup(
    benchmark: BenchmarkFixture, photographs: tuple[GreyPhotograph, GreyPhotograph, torch.Tensor]
) -> None:
    """As many values looked up by OpenCV, and nothing else."""
    here, _, xy = photographs
    grey = here.grey.numpy()
    x, y = (xy[:, axis, None].float().expand(-1, 11 * 49).contiguous().numpy() for axis in (0, 1))
    benchmark(lambda: cv2.remap(grey, x, y, cv2.INTER_LINEAR))


@pytest.mark.parametrize("way", ["as trained", "folded", "folded, bfloat16", "quantized"])
@pytest.mark.benchmark(group="the shipped network on 512 x 512")
def test_network(benchmark: BenchmarkFixture, way: str) -> None:
    network, _ = read_network(SHIPPED)
    half = way.endswith("bfloat16")
    if way != "as trained":
        fuse_layers(network, "bfloat16" if half else "float32")
    image = torch.rand(1, 3, 512, 512).contiguous(memory_format=torch.channels_last)
    if way == "quantized":
        if not torch.cpu._is_vnni_supported():
            pytest.skip("the processor has no units for integers (VNNI)")
        with torch.inference_mode(), largest_values(network) as largest:
            network(image)
        network = quantize(network, channel_scales(largest), network.config.strides)
    with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16, enabled=half):
        assert len(benchmark(network, image)) == 3


@pytest.mark.benchmark(group="the shipped network on 512 x 512")
def test_network_bare_product(benchmark: BenchmarkFixture) -> None:
    """A product of matrices of as many operations: 21.9e9."""
    a, b = torch.rand(2, 2219, 2219)
    with torch.inference_mode():
        benchmark(lambda: a @ b)
