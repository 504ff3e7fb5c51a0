"""Compare a flight localized as a sequence with and without tracking, frame by frame in turn.

    python -m experiments.tracked PLACE --cache CACHE [--flight SCENE] [--threads 2] [--alone]

PLACE is a simulated scene with a map and a session ``flight``, such as that of
``experiments/tracked-place.yaml``, or its map alone if SCENE has the session. Each frame is read
from its JPEG and localized with the prediction of the frames before. The first has a prior
(position to 3 m, attitude to 3 degrees), the others have none. Seconds are medians per frame,
wall-clock and of the processor; on a machine with other work, read the ratio. ``--alone`` runs
only with tracking, because a query without it returns memory that the next frame must allocate
again.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from objconnect.localization.pipeline.localization_map import LocalizationMap, open_map
from objconnect.localization.pipeline.tracking import SequenceConfig, Tracker
from objconnect.methods import create
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Prior, Query, Status
from objconnect.scene.runtime.tuning import ProcessTuning
from objconnect.scene.storage.images import read_rgb

# Bounds of errors (m, deg) within which a frame counts in recall.
BOUNDS = ((0.25, 2.0), (0.5, 5.0))
SEED = 0


@dataclass(frozen=True)
class Frame:
    """A frame of the flight: its file, camera, time and true pose."""

    path: Path
    camera: Camera
    seconds: float
    truth: Pose


@dataclass
class Run:
    """A tracker with the errors and the seconds of each frame."""

    name: str
    tracker: Tracker
    errors: list[tuple[float, float]] = field(default_factory=list)
    clock: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)

    def take(self, frame: Frame, prior: Prior | None) -> None:
        """Localize the next frame."""
        clock, processor = time.perf_counter(), time.process_time()
        query = Query(frame.path.name, read_rgb(frame.path), frame.camera, prior)
        estimate = self.tracker.localize(query, frame.seconds)
        self.tracker.update(estimate, frame.seconds)
        self.clock.append(time.perf_counter() - clock)
        self.processor.append(time.process_time() - processor)
        error = (np.inf, np.inf)
        if estimate.status is Status.OK and estimate.cam_from_world is not None:
            metres, degrees = estimate.cam_from_world.error_to(frame.truth)
            error = float(metres), float(degrees)
        self.errors.append(error)

    def figures(self, reference: Run) -> dict[str, Any]:
        """Return the figures of the run, with ratios to the seconds of a reference run."""
        errors = np.array(self.errors)
        found = np.isfinite(errors[:, 0])
        false = found & ((errors[:, 0] > 5) | (errors[:, 1] > 10))
        return {
            "run": self.name,
            "frames": len(errors),
            "found": int(found.sum()),
            "searched": self.tracker.search_count,
            "false": int(false.sum()),
            "within": {
                f"{metres:g} m {degrees:g} deg": int((errors < (metres, degrees)).all(1).sum())
                for metres, degrees in BOUNDS
            },
            "median": np.median(errors, 0).round(3).tolist(),
            "worst_m": round(float(errors[found, 0].max(initial=0)), 3),
            "clock_s": round(float(np.median(self.clock)), 3),
            "processor_s": round(float(np.median(self.processor)), 3),
            "processor_mean_s": round(float(np.mean(self.processor)), 3),
            "processor_ratio": ratio(self.processor, reference.processor),
            "clock_ratio": ratio(self.clock, reference.clock),
        }


def ratio(seconds: Sequence[float], reference: Sequence[float]) -> float:
    """Return the median over the frames of the ratio of two lists of seconds."""
    return round(float(np.median(np.array(seconds) / np.array(reference))), 3)


def frames_of(scene: Scene, session: str, every: int, rate_hz: float) -> list[Frame]:
    """Return every n-th frame of a session with a given frame rate."""
    frames = scene.frames(session)
    return [
        Frame(
            scene.images_root / frames.names[row],
            frames.cameras[row],
            row / rate_hz,
            Pose.from_matrix(frames.cam_from_world[row]),
        )
        for row in range(0, len(frames.names), every)
    ]


def prior_of(frame: Frame) -> Prior:
    """Return the prior of the first frame, with an error of about a standard deviation."""
    rng = np.random.default_rng(SEED)
    turn = Pose.exp(torch.from_numpy(np.append(np.radians(rng.normal(0, 3, 3)), np.zeros(3))))
    rotation = (turn.rotation @ frame.truth.rotation).numpy()
    position = frame.truth.centre().numpy() + rng.normal(0, 3, 3)
    return Prior(position, np.full(3, 3.0), rotation, 3.0)


def create_run(
    localization_map: LocalizationMap, cache: Path, method: str, settings: dict[str, Any], name: str
) -> Run:
    """Return a run that is ready for its first frame."""
    localizer = create(method, settings)
    localizer.prepare(localization_map.sparse_map, localization_map.images, cache)
    return Run(name, Tracker(localizer, SequenceConfig()))


def main() -> None:
    """Print the figures of both runs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("place", type=Path)
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--flight", type=Path)
    parser.add_argument("--session", default="flight")
    parser.add_argument("--rate", type=float, default=5.0, help="frames per second of the flight")
    parser.add_argument("--every", type=int, default=1, help="take every n-th frame")
    parser.add_argument("--method", default="objconnect")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--alone", action="store_true")
    parser.add_argument("--tracking", default="{}", help="options of tracking as JSON")
    parser.add_argument(
        "--set", action="append", default=[], help="KEY=VALUE of the method, for both runs"
    )
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    localization_map, scene = open_map(args.place), Scene.open(args.flight or args.place)
    frames = frames_of(scene, args.session, args.every, args.rate)
    settings: dict[str, Any] = dict(each.split("=", 1) for each in args.set)
    tracking = settings | {"tracking": json.loads(args.tracking)}
    runs = [create_run(localization_map, args.cache, args.method, tracking, "tracked")]
    if not args.alone:
        alone = settings | {"tracking": None}
        untracked = create_run(localization_map, args.cache, args.method, alone, "without")
        runs.insert(0, untracked)
    for number, frame in enumerate(frames):
        prior = prior_of(frame) if number == 0 else None
        for run in runs if number % 2 else runs[::-1]:
            run.take(frame, prior)
    for run in runs:
        print(json.dumps(run.figures(runs[0])), flush=True)
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    with ProcessTuning():  # as the command line
        main()
