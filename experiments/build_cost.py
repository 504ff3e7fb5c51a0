"""Cost of building a place: `python -m experiments.build_cost [PRESET:AREA:SEED ...]`.

Each place is built, and one small frame of it rendered, in its own process.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

_PLACES = (
    "town:400:7",
    *(f"town:2000:{seed}" for seed in (0, 1, 7)),
    *(f"{name}:2000:7" for name in ("suburb", "industrial", "park", "farmland")),
)


def main(places: list[str]) -> None:
    """Print a table with one line per place."""
    columns = ["place (side in m, seed)", "objects", "plan, cpu-s", "scene, cpu-s"]
    columns += ["first frame, cpu-s", "together, s", "peak memory, GB"]
    print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|", flush=True)
    for place in places:
        subprocess.run(
            [sys.executable, "-m", "experiments.build_cost", "--alone", place],
            cwd=Path(__file__).parents[1],
            stderr=subprocess.DEVNULL,
            check=True,
        )


def measure_place(place: str) -> None:
    """Build one place in this process, and print its line."""
    import numpy as np

    from simulate.camera.pinhole import PinholeCamera
    from simulate.look.conditions import condition
    from simulate.place.presets import preset
    from simulate.render.blender import _build_scene, _claim_stdout, _render, _set_up_render
    from simulate.render.job import RenderJob

    out = _claim_stdout()
    name, area, seed = place.split(":")
    began, spent = time.monotonic(), [time.process_time()]
    world = preset(name)(int(seed), float(area))
    spent.append(time.process_time())
    _build_scene(world, condition("summer-noon"))
    spent.append(time.process_time())
    camera = PinholeCamera(width=64, height=64, f=55, cx=32, cy=32)
    job = RenderJob(
        seed=int(seed),
        side_m=float(area),
        condition="summer-noon",
        camera=camera,
        samples=1,
        poses={},
    )
    _set_up_render(job, 0)
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    down[2, 3] = 80.0 + world.terrain.height(0.0, 0.0)
    with tempfile.TemporaryDirectory() as scratch:
        _render(down, np.zeros(3), Path(scratch), np.arange(1 + len(world.objects)))
    spent.append(time.process_time())
    plan, scene, first = np.diff(spent)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # from kilobytes
    print(
        f"| {name} ({area}, {seed}) | {len(world.objects)} | {plan:.1f} | {scene:.1f} | {first:.1f}"
        f" | {time.monotonic() - began:.0f} | {peak:.1f} |",
        file=out,
        flush=True,
    )


if __name__ == "__main__":
    if sys.argv[1:2] == ["--alone"]:
        measure_place(sys.argv[2])
    else:
        main(sys.argv[1:] or list(_PLACES))
