"""Render a flight on a cluster, whose workers return finished files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path

from objconnect.scene.runtime.cluster import WorkerPool, split_work
from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.scratch import scratch
from simulate.render.job import RenderJob, frame_path
from simulate.render.pool import FRAMES_PER_PROCESS, iterate_rendering

# With fewer frames, building the place takes longer than rendering.
_MIN_FRAMES = 8


def render_files(share: RenderJob) -> Iterator[tuple[int, bytes]]:
    """Render all frames of a job with one process and one thread, on a worker.

    Yields:
        The number and the file of each frame in the order of their numbers; in a tiled place, one
        window (a square of tiles) after the other, each in this order.
    """
    with (
        scratch() as folder,
        closing(iterate_rendering(share, folder, threads=1)) as frames,
    ):
        for frame in frames:
            path = frame_path(folder, frame)
            yield frame, path.read_bytes()
            path.write_bytes(b"")  # marks the frame as finished without using disk space


def render_remotely(
    workers: WorkerPool[RenderJob, tuple[int, bytes]],
    job: RenderJob,
    out_dir: Path,
    on_frame: Callable[[int], None],
) -> None:
    """Render every frame of a job that does not exist yet, as ``pool.render`` does.

    Only this process writes to ``out_dir``, so workers need no shared folder.
    """
    out_dir.mkdir(parents=True, exist_ok=True)
    missing = [
        frame
        for part in job.by_window()
        for frame in sorted(part.poses)
        if not frame_path(out_dir, frame).exists()
    ]
    with closing(workers.map(split_job(job, missing, workers.cores))) as files:
        for frame, data in files:
            with atomic_write(frame_path(out_dir, frame)) as partial:
                partial.write_bytes(data)
            on_frame(frame)


def split_job(job: RenderJob, frames: Sequence[int], cores: int) -> Iterator[RenderJob]:
    """Yield shares of a job's frames for ``cores`` cores."""
    for share in split_work(frames, cores, _MIN_FRAMES, FRAMES_PER_PROCESS):
        yield job.model_copy(update={"poses": {i: job.poses[i] for i in share}})
