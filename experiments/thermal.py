"""Draw a place in colour and in thermal pictures, and measure what they cost.

``python -m experiments.thermal --out docs/images/thermal.jpg`` draws the picture;
``python -m experiments.thermal --cost`` prints the processor seconds of a frame without and with
thermal pictures.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from objconnect.scene.bundle.frames import LAYERS, write_frames
from objconnect.scene.bundle.thermal import picture_path
from objconnect.scene.storage.atomic import atomic_write
from simulate.command import _frames, _pack, _thermal, render_job
from simulate.config import SimulateConfig
from simulate.place.presets import preset
from simulate.planner import plan_session, session_generator
from simulate.render.pool import render

_PRESET, _SEED, _AREA_M = "harbour", 7, 160.0
_FRAMES = 6
_GAP_PX = 4


def _config(size: int, *, thermal: bool) -> SimulateConfig:
    sessions = [
        {"condition": name, "flight": "oblique", "role": role, "frames": _FRAMES}
        for name, role in (("summer-noon", "map"), ("summer-night", "query"))
    ]
    return SimulateConfig.model_validate(
        {"preset": _PRESET, "seed": _SEED, "area": _AREA_M, "size": size, "spp": 4,
         "thermal": thermal, "sessions": sessions}
    )  # fmt: skip


def _children_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def render_session(
    config: SimulateConfig, session: int, folder: Path, frames: range
) -> tuple[float, float]:
    """Render and pack frames of a session; return the processor seconds of rendering and packing.

    Every session flies the course of the first.
    """
    world = preset(config.preset)(config.seed, config.area)
    camera = config.photo_camera()
    rng = session_generator(config, 0)
    poses = plan_session(config.sessions[0], config, camera, world, rng)
    chosen = config.sessions[session]
    job = render_job(config, chosen, poses[list(frames)])
    before = _children_seconds()
    render(job, folder / ".objconnect-rendered")
    rendering = _children_seconds() - before
    frame_poses = poses[list(frames)]
    session_frames = _frames(
        folder.name, frame_poses, camera, chosen, config, np.random.default_rng(0)
    )
    start = time.process_time()
    packed = _pack(folder, session_frames, config, _thermal(config, chosen))
    write_frames(folder / "frames.h5", session_frames, tuple(LAYERS), packed)
    return rendering, time.process_time() - start


def print_cost(size: int) -> None:
    """Print the processor seconds of a frame without and with thermal pictures.

    Both include their share of the time to start Blender and to build the place, in which the
    thermal camera casts the shade of each hour.
    """
    for thermal in (False, True):
        with tempfile.TemporaryDirectory() as scratch:
            config = _config(size, thermal=thermal)
            spent = render_session(config, 0, Path(scratch) / "session", range(_FRAMES))
        rendering, packing = (seconds / _FRAMES for seconds in spent)
        print(f"{thermal=}: {rendering:.2f} s of rendering, {packing:.2f} s of packing a frame")


def draw(out: Path, size: int, frame: int) -> None:
    """Write a photograph at noon and thermal pictures at noon and at night, side by side."""
    config = _config(size, thermal=True)
    with tempfile.TemporaryDirectory() as scratch:
        shown = []
        for session in (0, 1):
            folder = Path(scratch) / f"session-{session}"
            render_session(config, session, folder, range(frame, frame + 1))
            name = f"{folder.name}/images/000000.jpg"
            if session == 0:
                shown.append(np.asarray(Image.open(folder.parent / name)))
            grey = np.asarray(Image.open(picture_path(folder.parent, name)))
            shown.append(cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB))
        gap = np.full((size, _GAP_PX, 3), 255, np.uint8)
        row = np.hstack([shown[0], gap, shown[1], gap, shown[2]])
        with atomic_write(out) as partial:
            Image.fromarray(row).save(partial, "JPEG", quality=85)


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="picture to write")
    parser.add_argument("--cost", action="store_true", help="measure what a frame costs")
    parser.add_argument("--size", type=int, default=512, help="pixels of a side")
    parser.add_argument("--frame", type=int, default=0, help="frame of the course to draw")
    arguments = parser.parse_args()
    if arguments.out is not None:
        draw(arguments.out, arguments.size, arguments.frame)
    if arguments.cost:
        print_cost(arguments.size)


if __name__ == "__main__":
    main()
