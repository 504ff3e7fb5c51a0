"""A Blender process that renders frames one by one for the benchmarks."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

from simulate.camera.pinhole import PinholeCamera
from simulate.config import SimulateConfig
from simulate.flight.config import NadirFlight
from simulate.flight.context import FlightContext
from simulate.flight.flights import plan_nadir
from simulate.place.presets import preset
from simulate.render.job import RenderJob
from tests.blender import require_blender

ROOT = Path(__file__).parents[1]


def nadir_job(config: SimulateConfig, frames: int) -> RenderJob:
    """Return the job of nadir photographs under the condition of the first session."""
    camera = config.photo_camera()
    world = preset(config.preset)(config.seed, config.area)
    context = FlightContext(config.area, world.terrain.height, camera)
    poses = plan_nadir(NadirFlight(altitude_m=80.0), context, frames, np.random.default_rng(0))
    pinhole = PinholeCamera(
        width=config.size,
        height=config.size,
        f=camera.focal[0],
        cx=camera.principal[0],
        cy=camera.principal[1],
    )
    return RenderJob(
        preset=config.preset,
        seed=config.seed,
        side_m=config.area,
        condition=config.sessions[0].condition,
        camera=pinhole,
        samples=config.spp,
        denoising=config.denoising,
        poses={k: poses[k % len(poses)].tolist() for k in range(frames)},
    )


class Renderer:
    """A Blender process that renders a frame on request."""

    def __init__(self, job: RenderJob, folder: Path) -> None:
        require_blender()
        self.rendered = folder / ".objconnect-rendered"
        self.rendered.mkdir(parents=True)
        path = folder / "job.json"
        path.write_text(job.model_dump_json())
        arguments = ["-m", "experiments.render_frames", str(path), str(self.rendered)]
        self.process = subprocess.Popen(
            [sys.executable, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=ROOT,
        )

    def ask(self, kind: str, frame: int, *settings: str) -> tuple[float, int]:
        """Return the processor seconds of a frame, and the bytes of the process after it."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        print(kind, frame, *settings, file=self.process.stdin, flush=True)
        seconds, resident = self.process.stdout.readline().split()
        return float(seconds), int(resident)

    def stop(self) -> None:
        self.process.kill()
        self.process.wait()
