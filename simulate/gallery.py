"""One place under many conditions, as one picture: ``python -m simulate.gallery --help``."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from scene.errors import InputError
from scene.files import written_whole
from scene.progress import progress_bar
from simulate.command import render_job
from simulate.config import SessionConfig, SimulateConfig
from simulate.flight.flights import plan_oblique
from simulate.look.conditions import condition
from simulate.place.presets import preset
from simulate.render.job import frame_path
from simulate.render.pool import RenderError, render

_COLUMNS = 4


def draw_conditions(config: SimulateConfig, conditions: Sequence[str], path: Path) -> None:
    """Draw the place of a configuration under each condition, from the query orbit's first pose.

    Raises:
        InputError: an unknown condition, rendering failed, or ``path`` cannot be written.
    """
    place = preset(config.preset)(config.seed, config.area)
    pose = plan_oblique(
        place.terrain.height,
        radius_m=config.query_plan.orbit_radius_share * config.area,
        altitude_m=config.query_plan.orbit_altitude_m,
        start_deg=config.query_plan.orbit_start_deg,
        frames=1,
        rng=np.random.default_rng(config.seed),
    )[0]
    names = [condition(name, config.origin).name for name in conditions]
    sessions = [SessionConfig(condition=name, flight="oblique", role="query") for name in names]
    with tempfile.TemporaryDirectory(prefix="gallery-") as scratch:
        shots = []
        with progress_bar("conditions", len(sessions)) as advance:
            for k, session in enumerate(sessions):
                shots.append(_photograph(config, session, pose, Path(scratch) / str(k)))
                advance(k + 1)
    rows = -(-len(shots) // _COLUMNS)
    figure = Figure(figsize=(3 * min(len(shots), _COLUMNS), 3.2 * rows), layout="constrained")
    axes = figure.subplots(rows, min(len(shots), _COLUMNS), squeeze=False)
    for ax in axes.flat:
        ax.set_axis_off()
    for ax, shot, session in zip(axes.flat, shots, sessions, strict=False):
        ax.imshow(shot)
        ax.set_title(session.condition, fontsize=10)
    with written_whole(path) as partial:
        figure.savefig(partial, format="png", dpi=110)


def _photograph(
    config: SimulateConfig, session: SessionConfig, pose: NDArray[np.float64], folder: Path
) -> NDArray[np.uint8]:
    """The place under a session's condition, (H, W, 3)."""
    job = render_job(config, session, pose[None])
    try:
        render(job, folder)
    except RenderError as error:
        raise InputError(str(error)) from error
    with np.load(frame_path(folder, 0)) as layers:
        return np.asarray(layers["rgb"])


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; 0 when the picture is written, else 2 after one line."""
    parser = argparse.ArgumentParser("python -m simulate.gallery", description=__doc__)
    parser.add_argument("conditions", nargs="+", metavar="SEASON-LIGHT[-WEATHER]")
    parser.add_argument("--config", type=Path, metavar="YAML", help="as of objconnect simulate")
    parser.add_argument("--out", type=Path, default=Path("pictures/conditions.png"), metavar="PNG")
    options = parser.parse_args(arguments)
    try:
        config = SimulateConfig.load(options.config, {})
        draw_conditions(config, options.conditions, options.out)
    except InputError as error:
        print(f"objconnect: error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
