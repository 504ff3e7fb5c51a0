"""Renders a flight on a cluster: shares of its frames go out, finished files come back."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path

from scene.runtime.cluster import WorkerPool, split_work
from scene.storage.atomic import atomic_write
from scene.storage.scratch import scratch
from simulate.render.job import RenderJob, frame_path
from simulate.render.pool import FRAMES_PER_PROCESS, rendering

# A share of fewer frames costs more for its place, which is built first, than for them.
_WORTH_A_PROCESS = 8


def frame_files(share: RenderJob) -> Iterator[tuple[int, bytes]]:
    """Render all frames of a job with one process and one thread: the work of a crew.

    Yields the number and the file of each, in the order of their numbers.
    """
    with (
        scratch() as folder,
        closing(rendering(share, folder, threads=1)) as frames,
    ):
        for frame in frames:
            path = frame_path(folder, frame)
            yield frame, path.read_bytes()
            path.write_bytes(b"")  # it is there, and takes no room


def render_remotely(
    crew: WorkerPool[RenderJob, tuple[int, bytes]],
    job: RenderJob,
    out_dir: Path,
    on_frame: Callable[[int], None],
) -> None:
    """Render every frame of `job` that `out_dir` does not hold yet, as `pool.render` does.

    Only this process writes to `out_dir`: no folder need be shared.
    """
    out_dir.mkdir(parents=True, exist_ok=True)
    missing = [i for i in sorted(job.poses) if not frame_path(out_dir, i).exists()]
    with closing(crew.map(divided(job, missing, crew.cores))) as files:
        for frame, data in files:
            with atomic_write(frame_path(out_dir, frame)) as partial:
                partial.write_bytes(data)
            on_frame(frame)


def divided(job: RenderJob, frames: Sequence[int], cores: int) -> Iterator[RenderJob]:
    """Shares of a job's frames for the workers of so many cores."""
    for share in split_work(frames, cores, _WORTH_A_PROCESS, FRAMES_PER_PROCESS):
        yield job.model_copy(update={"poses": {i: job.poses[i] for i in share}})
