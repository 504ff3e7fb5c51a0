"""What a frame costs, and what costs it: `python -m tests.benchmarks.frame_cost`."""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from scene.bundle.frames import LAYERS, write_frames
from simulate.command import _frames, _pack
from simulate.config import SimulateConfig
from tests.benchmarks.renderer import Renderer, nadir_job

_FRAMES = 5
_KINDS = ("still", "flat", "raw", "bare", "ours")


def frame_cost(config: SimulateConfig) -> dict[str, float]:
    """Processor seconds a frame of `config`'s first session, by part: medians over frames."""
    job = nadir_job(config, _FRAMES)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "session"
        renderer = Renderer(job, folder)
        try:
            spent = {}
            for kind in _KINDS:
                renderer.ask(kind, 0)  # Blender takes in what differs from the kind before
                asked = [renderer.ask(kind, k)[0] for k in range(_FRAMES)]
                spent[kind] = float(np.median(asked))
        finally:
            renderer.stop()
        poses = np.array([job.poses[k] for k in range(_FRAMES)])
        rng = np.random.default_rng(0)
        frames = _frames(folder.name, poses, config.photo_camera(), config.sessions[0], config, rng)
        start = time.process_time()
        write_frames(folder / "frames.h5", frames, tuple(LAYERS), _pack(folder, frames, config))
        packing = (time.process_time() - start) / _FRAMES
    return {
        "taking in the scene": spent["still"],
        "rays to the first surface": spent["flat"] - spent["still"],
        "light and shading": spent["raw"] - spent["flat"],
        "denoiser": spent["bare"] - spent["raw"],
        "**the picture alone**": spent["bare"],
        "layers": spent["ours"] - spent["bare"],
        "packing": packing,
        "**a frame with everything**": spent["ours"] + packing,
    }


def main() -> None:
    """Print the table."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("--preset", default="town")
    words.add_argument("--condition", default="summer-noon")
    words.add_argument("--area", type=float, default=400)
    words.add_argument("--size", type=int, default=512)
    words.add_argument("--spp", type=int, default=4)
    asked = vars(words.parse_args())
    session = {
        "condition": asked.pop("condition"), "flight": "nadir", "role": "map", "frames": _FRAMES,
    }  # fmt: skip
    config = SimulateConfig.model_validate({"seed": 7, "sessions": [session], **asked})
    cost = frame_cost(config)
    print("| part of a frame | cpu-seconds |\n|---|---|")
    for part, seconds in cost.items():
        print(f"| {part} | {seconds:.2f} |")
    ratio = cost["**a frame with everything**"] / cost["**the picture alone**"]
    print(f"Everything over the picture alone: {ratio:.3f}")


if __name__ == "__main__":
    main()
