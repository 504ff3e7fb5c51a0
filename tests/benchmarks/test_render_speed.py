"""A frame of the generator beside a bare Blender render of it: read the ratio, not the seconds."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from experiments.renderer import Renderer, nadir_job
from objconnect.scene.bundle.frames import LAYERS, read_frames, write_frames
from simulate.command import _frames, _pack
from simulate.config import SimulateConfig

pytestmark = pytest.mark.thorough

POSES = 4
CONFIG = SimulateConfig.model_validate(
    {
        "seed": 7,
        "area": 160,
        "sessions": [
            {"condition": "summer-noon", "flight": "nadir", "role": "map", "frames": 1},
        ],
    }
)


@pytest.fixture(scope="module")
def renderer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Renderer]:
    folder = tmp_path_factory.mktemp("speed") / "session"
    process = Renderer(nadir_job(CONFIG, POSES), folder)
    try:
        process.ask("bare", 0)  # Blender builds its trees once
        yield process
    finally:
        process.stop()


@pytest.mark.benchmark(group="render a frame of 512 x 512 at 4 paths a pixel", min_rounds=12)
def test_frame_bare(benchmark: BenchmarkFixture, renderer: Renderer) -> None:
    frames = cycle(range(POSES))
    assert benchmark(lambda: renderer.ask("bare", next(frames)))[0] > 0


@pytest.mark.benchmark(group="render a frame of 512 x 512 at 4 paths a pixel", min_rounds=12)
def test_frame_with_layers(benchmark: BenchmarkFixture, renderer: Renderer) -> None:
    frames = cycle(range(POSES))
    assert benchmark(lambda: renderer.ask("ours", next(frames)))[0] > 0


@pytest.mark.benchmark(group="render a frame of 512 x 512 at 4 paths a pixel", min_rounds=12)
def test_packing_a_frame(benchmark: BenchmarkFixture, renderer: Renderer) -> None:
    """JPEG and compressed layers of a rendered frame: a part of ours, not a rival."""
    session = CONFIG.sessions[0]
    pose = np.array([nadir_job(CONFIG, POSES).poses[0]])
    rng = np.random.default_rng(0)
    folder = renderer.rendered.parent
    renderer.ask("ours", 0)  # alone, this test finds no layers rendered yet
    frames = _frames(folder.name, pose, CONFIG.photo_camera(), session, CONFIG, rng)
    path = folder / "frames.h5"

    benchmark(lambda: write_frames(path, frames, tuple(LAYERS), _pack(folder, frames, CONFIG)))
    assert len(read_frames(path)) == 1


@pytest.mark.slow
def test_memory_does_not_grow(tmp_path: Path) -> None:
    """300 frames of 64 px in one process: under 100 MB more than after the first ten."""
    config = CONFIG.model_copy(update={"size": 64, "spp": 1})
    process = Renderer(nadir_job(config, 300), tmp_path / "session")
    try:
        held = [process.ask("ours", frame)[1] for frame in range(300)]
    finally:
        process.stop()
    growth = (max(held[10:]) - held[10]) / 1e6
    print(f"{held[10] / 1e6:.0f} MB, and {growth:.0f} MB more over 300 frames")
    assert growth < 100
