"""Cost of a frame in a tiled place and in one without tiles: `python -m experiments.tile_cost`.

The same survey from 100 m is rendered in the middle of each place, with one process and one thread.
Processor seconds of a frame are the difference between renders of many frames and of one.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.runtime.progress import progress_bar
from simulate.camera.lens import cover_by_pinhole
from simulate.command import render_job
from simulate.config import SimulateConfig
from simulate.place.presets import PRESETS
from simulate.place.tiles import TiledPlace, is_tiled
from simulate.render.job import RenderChunk, RenderJob
from simulate.tiled_scene import TiledScene

_ALTITUDE_M, _STEP_M = 100.0, 10.0


def survey_job(preset: str, seed: int, side_m: float, condition: str, frames: int) -> RenderJob:
    """Return the job of a line of frames through the middle of a place, all in one window."""
    config = SimulateConfig.model_validate(
        {
            "preset": preset,
            "seed": seed,
            "area": side_m,
            "sessions": [{"condition": condition, "flight": "nadir", "role": "map"}],
        }
    )
    (session,) = config.sessions
    poses = np.stack([_look_down(_STEP_M * k) for k in range(frames)])
    if not is_tiled(side_m):
        return render_job(config, session, poses)
    place = TiledPlace(PRESETS.load(preset), seed, side_m)
    scene = TiledScene(place, [session.world_change])
    views = scene.find_views("survey", cover_by_pinhole(config.photo_camera())[0], poses)
    (window,) = scene.number([views]).windows(0, views)
    return render_job(config, session, poses, windows=(window,))


def _look_down(east_m: float) -> NDArray[np.float64]:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = [-east_m, 0.0, _ALTITUDE_M]
    return pose


def measure(job: RenderJob, frames: int) -> tuple[float, float]:
    """Render the first frames of a job; return processor seconds and peak memory (bytes)."""
    poses = {k: job.poses[k] for k in range(frames)}
    with tempfile.TemporaryDirectory() as scratch:
        chunk = RenderChunk(
            job=job.model_copy(update={"poses": poses}),
            rays=None,
            out_dir=Path(scratch),
            threads=1,
            max_growth_bytes=1 << 40,
            parent=os.getpid(),
        )
        path = Path(scratch) / "chunk.json"
        path.write_text(chunk.model_dump_json())
        command = [sys.executable, "-m", "simulate.render.blender", str(path)]
        root = Path(__file__).parents[1]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, cwd=root)
        _, status, usage = os.wait4(process.pid, 0)
        if status:
            raise RuntimeError(f"the rendering process failed with status {status}")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024.0


def main() -> None:
    """Print one line per place."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--preset", default="town")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--condition", default="summer-noon")
    parser.add_argument("--sides", type=float, nargs="+", default=[1000.0, 5000.0])
    parser.add_argument("--frames", type=int, default=9)
    args = parser.parse_args()
    print("| side, m | first frame, cpu-s | a further frame, cpu-s | peak memory, GB |")
    print("|--:|--:|--:|--:|")
    with progress_bar("places", len(args.sides)) as advance:
        for done, side_m in enumerate(args.sides, 1):
            job = survey_job(args.preset, args.seed, side_m, args.condition, args.frames)
            first, _ = measure(job, 1)
            together, peak = measure(job, args.frames)
            each = (together - first) / (args.frames - 1)
            print(f"| {side_m:.0f} | {first:.1f} | {each:.2f} | {peak / 1e9:.2f} |", flush=True)
            advance(done)


if __name__ == "__main__":
    main()
