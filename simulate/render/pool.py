"""Render a flight with a pool of Blender processes."""

from __future__ import annotations

import math
import os
import queue
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from itertools import count
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.storage.scratch import scratch
from simulate.look.conditions import condition
from simulate.place.presets import preset
from simulate.render.job import FrameDone, RenderChunk, RenderJob, frame_path
from simulate.render.libraries import PACKAGES

# A process ends after this many frames, which frees memory that Blender leaks.
FRAMES_PER_PROCESS = 200
# A process also ends when its memory has grown by this much since its first frame (bytes).
_MAX_GROWTH_BYTES = 1_000_000_000


class RenderError(RuntimeError):
    """A rendering process failed. The message gives the reason in one line."""


def render(
    job: RenderJob,
    out_dir: Path,
    processes: int = 1,
    on_frame: Callable[[int], None] | None = None,
) -> None:
    """Render every frame of a job that does not exist yet.

    A frame is a file ``NNNNNN.npz`` with rgb (H, W, 3) uint8 sRGB, depth (H, W) float32 planar
    metres (0: no surface), instance (H, W) uint16 object ids (0: ground or sky), semantic (H, W)
    uint8 labels (none if a calibration board is rendered, ``RenderJob.board``) and normal (H, W, 3)
    int8 world normals times 127. The file appears only when it is complete.

    Args:
        job: the frames.
        out_dir: folder of the frames.
        processes: number of processes.
        on_frame: called in this thread with the number of each finished frame.

    Raises:
        InputError: the preset or condition is unknown, or the origin does not have the condition's
            light.
        RenderError: a process failed; finished frames remain.
    """
    with closing(iterate_rendering(job, out_dir, processes)) as frames:
        for frame in frames:
            if on_frame is not None:
                on_frame(frame)


def iterate_rendering(
    job: RenderJob, out_dir: Path, processes: int = 1, threads: int | None = None
) -> Generator[int, None, None]:
    """Render as ``render`` does, and yield the number of each finished frame.

    Each process has ``threads`` threads; with None, the processes share the processors. A single
    process finishes frames in the order of their numbers. In a tiled place it renders one window (a
    square of tiles) after the other, each in this order.
    """
    condition(job.condition, job.origin)
    preset(job.preset, job.site_path)
    out_dir.mkdir(parents=True, exist_ok=True)
    missing = [i for i in sorted(job.poses) if not frame_path(out_dir, i).exists()]
    if not missing:
        return
    processes = max(1, min(processes, len(missing)))
    if threads is None:
        threads = 0 if processes == 1 else max(1, (os.cpu_count() or 1) // processes)
    size = min(FRAMES_PER_PROCESS, math.ceil(len(missing) / processes))
    shares = deque(
        part.model_copy(update={"poses": {i: part.poses[i] for i in frames[k : k + size]}})
        for part in job.by_window()
        if (frames := [i for i in sorted(part.poses) if i in missing])
        for k in range(0, len(frames), size)
    )
    with scratch(out_dir) as folder:
        rays = None
        if job.distorted_camera is not None:
            rays = folder / "rays.npy"
            np.save(rays, _camera_rays(job.distorted_camera))
        numbers = count()

        def start(share: RenderJob) -> _BlenderProcess:
            chunk = RenderChunk(
                job=share,
                rays=rays,
                out_dir=out_dir.resolve(),
                threads=threads,
                max_growth_bytes=_MAX_GROWTH_BYTES,
                parent=os.getpid(),
            )
            path = folder / f"{next(numbers)}.json"
            path.write_text(chunk.model_dump_json())
            return _BlenderProcess(path)

        yield from _run(shares, processes, start, out_dir)


def _camera_rays(camera_text: str) -> NDArray[np.float64]:
    """Return the rays x/z and y/z through every pixel centre of a camera, (H, W, 2)."""
    # Imported here, because it loads torch, which Blender's processes do not need.
    from objconnect.scene.geometry.camera import Camera

    camera = Camera.parse(camera_text.split())
    rays, _ = camera.unproject(camera.pixel_grid())
    return np.asarray(rays[..., :2].numpy())


class _BlenderProcess:
    """A Blender process. Its output lines are put into a queue."""

    def __init__(self, chunk: Path) -> None:
        root = str(Path(__file__).resolve().parents[2])
        path = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
        self._errors = chunk.with_suffix(".stderr")
        with self._errors.open("wb") as errors:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "simulate.render.blender", str(chunk)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                # A killed process leaves Blender's temporary files, which are in this folder.
                env={**os.environ, "PYTHONPATH": path, "TMPDIR": str(chunk.parent.resolve())},
            )

    def listen(self, lines: queue.Queue[tuple[_BlenderProcess, str | None]]) -> None:
        """Start a thread that puts every line into the queue, and None at the end."""

        def pump() -> None:
            assert self.process.stdout is not None
            for line in self.process.stdout:
                lines.put((self, line))
            lines.put((self, None))

        threading.Thread(target=pump, daemon=True).start()

    def check(self) -> None:
        """Wait for the process, and raise RenderError if it failed."""
        code = self.process.wait()
        if code == 0:
            return
        text = self._errors.read_text(errors="replace").strip()
        last = text.splitlines()[-1] if text else "no error output"
        if "cannot open shared object file" in last:
            last += f"; try: apt-get install {' '.join(PACKAGES.values())}"
        if "could not be saved" in last:
            last += ": the disk may be full"
        how = f"was killed by signal {-code}" if code < 0 else f"failed with exit code {code}"
        raise RenderError(f"the rendering process {how}: {last}")

    def stop(self) -> None:
        """End the process if it is still running."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()


def _run(
    shares: deque[RenderJob],
    processes: int,
    start: Callable[[RenderJob], _BlenderProcess],
    out_dir: Path,
) -> Iterator[int]:
    """Run up to ``processes`` processes at once, one per share, and yield the finished frames.

    Remaining frames of a process that ends early go to another process.

    Raises:
        RenderError: a process failed.
    """
    lines: queue.Queue[tuple[_BlenderProcess, str | None]] = queue.Queue()
    running: dict[_BlenderProcess, RenderJob] = {}
    try:
        while shares or running:
            while shares and len(running) < processes:
                share = shares.popleft()
                child = start(share)
                running[child] = share
                child.listen(lines)
            child, line = lines.get()
            if line is not None:
                yield FrameDone.model_validate_json(line).frame
                continue
            child.check()
            share = running.pop(child)
            left = {i: p for i, p in share.poses.items() if not frame_path(out_dir, i).exists()}
            if len(left) == len(share.poses):
                raise RenderError(f"the rendering process ended with {len(left)} frames missing")
            if left:
                shares.appendleft(share.model_copy(update={"poses": left}))
    finally:
        for child in running:
            child.stop()
