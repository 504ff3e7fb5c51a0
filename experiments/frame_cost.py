"""Cost of rendering a frame, by part: `python -m experiments.frame_cost`."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from experiments.renderer import Renderer, nadir_job
from objconnect.scene.bundle.frames import LAYERS, write_frames
from simulate.command import _frames, _pack
from simulate.config import SimulateConfig

_FRAMES = 5
# Kinds of renders, see ``experiments.render_frames``.
_KINDS = ("still", "flat", "raw", "bare", "ours")


def frame_cost(config: SimulateConfig, *settings: str) -> dict[str, float]:
    """Return the processor seconds of a frame of `config`'s first session by part, as medians.

    All frames are rendered with the same settings, so that Blender reads them once.
    """
    job = nadir_job(config, _FRAMES)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "session"
        renderer = Renderer(job, folder)
        try:
            spent = {}
            for kind in _KINDS:
                renderer.ask(kind, 0, *settings)  # Blender reads the changed settings
                seconds = [renderer.ask(kind, k, *settings)[0] for k in range(_FRAMES)]
                spent[kind] = float(np.median(seconds))
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


def try_settings(
    config: SimulateConfig, settings: Sequence[str], always: Sequence[str], paths: int
) -> Iterator[str]:
    """Yield a line for each setting: seconds of the picture alone, and its difference.

    Args:
        config: configuration of the frames.
        settings: each may combine several, separated by blanks.
        always: settings of all pictures.
        paths: paths per pixel of the reference picture, which is not denoised; 0 compares with the
            picture without the setting.
    """
    job = nadir_job(config, _FRAMES)
    with tempfile.TemporaryDirectory() as scratch:
        renderer = Renderer(job, Path(scratch) / "session")

        def picture(
            frame: int, *setting: str, kind: str = "bare"
        ) -> tuple[float, NDArray[np.float64]]:
            took = renderer.ask(kind, frame, *always, *setting)[0]
            with Image.open(renderer.rendered / "bare.png") as shown:
                return took, np.asarray(shown.convert("RGB"), float)

        rows: dict[str, list[tuple[float, float, float]]] = {}
        try:
            picture(0)  # Blender reads the scene
            for frame in range(_FRAMES):
                many = (f"cycles.samples={paths}", "cycles.seed=1")
                _, reference = picture(frame, *many, kind="raw") if paths else picture(frame)
                for setting in ("", *settings):
                    took, other = picture(frame, *setting.split())
                    difference = other - reference
                    row = (took, float(np.abs(difference).mean()), float((difference**2).mean()))
                    rows.setdefault(setting, []).append(row)
        finally:
            renderer.stop()
    for setting, found in rows.items():
        took, mean, square = np.median(found, 0)
        difference = (
            "none"
            if square == 0
            else f"{mean:.2f} grey levels, {20 * np.log10(255 / square**0.5):.1f} dB"
        )
        yield f"| {setting or 'as it is'} | {took:.2f} | {difference} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--preset", default="town")
    parser.add_argument("--condition", default="summer-noon")
    parser.add_argument("--area", type=float, default=400)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--spp", type=int, default=4)
    parser.add_argument("--with", action="append", default=[], help="settings of all parts")
    parser.add_argument("--try", action="append", default=[], help="settings as cycles.samples=2")
    parser.add_argument("--paths", type=int, default=0, help="per pixel of the picture of --try")
    options = vars(parser.parse_args())
    settings, always, paths = options.pop("try"), options.pop("with"), options.pop("paths")
    session = {
        "condition": options.pop("condition"), "flight": "nadir", "role": "map", "frames": _FRAMES,
    }  # fmt: skip
    config = SimulateConfig.model_validate({"seed": 7, "sessions": [session], **options})
    if settings:
        print("| | cpu-seconds | difference |\n|---|--:|---|")
        for line in try_settings(config, settings, always, paths):
            print(line, flush=True)
        return
    cost = frame_cost(config, *always)
    print("| part of a frame | cpu-seconds |\n|---|---|")
    for part, seconds in cost.items():
        print(f"| {part} | {seconds:.2f} |")
    ratio = cost["**a frame with everything**"] / cost["**the picture alone**"]
    print(f"Everything over the picture alone: {ratio:.3f}")


if __name__ == "__main__":
    main()
