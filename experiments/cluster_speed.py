"""Speed-up of rendering with two workers over one: `python -m experiments.cluster_speed`.

A Ray cluster on this machine renders the same frames in turn with one worker of one core and with
two, after every worker has rendered a frame. The place is built again for every share of frames,
as in a real run. Blender's processor seconds show how much of a core a worker had. On a machine
with other work, read the second ratio, which compares processor seconds.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Iterator
from typing import NamedTuple

from experiments.renderer import nadir_job
from objconnect.scene.runtime.cluster import worker_pool
from simulate.config import SimulateConfig
from simulate.render.job import RenderJob
from simulate.render.remote import render_files, split_job
from tests.two_nodes import TwoNodes

# Number of the item that holds the processor seconds of a share instead of a frame.
_SECONDS = -1


class Run(NamedTuple):
    """Wall-clock seconds, and processor seconds of all workers together."""

    seconds: float
    cpu: float


def render_and_time(share: RenderJob) -> Iterator[tuple[int, bytes]]:
    """Yield the frames of a share, then the processor seconds that they took."""
    before = _child_seconds()
    yield from render_files(share)
    yield _SECONDS, repr(_child_seconds() - before).encode()


def _child_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measure(address: str, workers: int, job: RenderJob) -> Run:
    """Render all frames of a job with all workers of a cluster."""
    with worker_pool(address, render_and_time) as team:
        assert team.cores == workers
        first = job.model_copy(update={"poses": {0: job.poses[0]}})
        for _ in team.map([first] * workers):
            pass
        began, cpu, frames = time.perf_counter(), 0.0, 0
        for frame, data in team.map(split_job(job, sorted(job.poses), workers)):
            if frame == _SECONDS:
                cpu += float(data)
            else:
                frames += 1
        assert frames == len(job.poses)
        return Run(time.perf_counter() - began, cpu)


def main() -> None:
    """Print every run, then the ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--area", type=float, default=160)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--frames", type=int, default=48)
    parser.add_argument("--turns", type=int, default=1)
    args = parser.parse_args()
    options = {"seed": 7, "area": args.area, "size": args.size}
    job = nadir_job(SimulateConfig.model_validate(options), args.frames)
    nodes = TwoNodes()
    runs: dict[int, list[Run]] = {1: [], 2: []}
    try:
        for _ in range(args.turns):
            for workers in (1, 2):
                nodes.set_node_count(workers)
                run = measure(nodes.address, workers, job)
                runs[workers].append(run)
                print(
                    f"{workers} workers: {run.seconds:.1f} s, {run.cpu:.1f} cpu-s, "
                    f"{run.cpu / run.seconds / workers:.2f} of a core each",
                    flush=True,
                )
    finally:
        nodes.end()
    one, two = (min(runs[workers]) for workers in (1, 2))
    print(f"by the clock two workers are {one.seconds / two.seconds:.2f} times as fast as one")
    print(f"by processor seconds, if each has a core to itself: {2 * one.cpu / two.cpu:.2f} times")


if __name__ == "__main__":
    main()
