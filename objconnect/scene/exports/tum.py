"""Export of trajectories in the format of the TUM RGB-D benchmark (Sturm et al., IROS 2012).

Each session (flight) is a file ``SESSION.txt`` with lines "timestamp tx ty tz qx qy qz qw" of
world_from_cam, in seconds and metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from objconnect.scene.bundle.frames import Frames
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError


def write(scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path) -> None:
    """Write a trajectory for each session; see ``formats.Writer``.

    Raises:
        InputError: a photograph has no time.
    """
    for name, frames in sessions.items():
        if np.isnan(frames.time).any():
            raise InputError(
                f"photographs of session {name} have no time, which a trajectory needs: export "
                "other sessions with --session"
            )
        world_from_cam = frames.poses.inverse()
        wxyz = world_from_cam.quaternion().numpy()
        rows = np.hstack([world_from_cam.translation.numpy(), np.roll(wxyz, -1, axis=1)])
        lines = [
            f"{time:.6f} {' '.join(repr(value) for value in row)}\n"
            for time, row in zip(frames.time.tolist(), rows.tolist(), strict=True)
        ]
        header = "# timestamp tx ty tz qx qy qz qw (world_from_cam: seconds, metres)\n"
        (folder / f"{name}.txt").write_text(header + "".join(lines), "utf-8")
