"""Localize a video whose GPS is lost, as a sequence and frame by frame.

    python -m experiments.sequences SCENE SESSION --map PLACE --out DIR [--black 50 60]

SCENE is a simulated scene of the same site as PLACE, which has the map. The session is exported as
a video with subtitles. From ``--lost-after`` seconds on these have no position; with
``--no-gimbal`` they have no attitude either. ``localize --video`` then runs twice: as a sequence,
and with ``sequence.lost_sigma_m`` so small that each frame is searched from its subtitles alone.
``--black`` blanks the frames of a time span, as fog does, after which the position is lost. A
second run continues an interrupted one, but its seconds are those of the last run: delete DIR to
measure again.
"""

from __future__ import annotations

import argparse
import json
import re
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from objconnect.localization.pipeline.answers import ImageEstimate
from objconnect.localization.pipeline.localization_map import open_map
from objconnect.localization.pipeline.localize import localize_video
from objconnect.localization.pipeline.options import LocalizeOptions
from objconnect.localization.pipeline.tracking import SequenceConfig
from objconnect.methods import create
from objconnect.scene.exports.export import export
from objconnect.scene.flights.textfiles import read_poses
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Localizer, Query
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.tuning import ProcessTuning
from objconnect.scene.storage.video import decode_frames, read_video, write_video

# Bounds of errors (m, deg) within which a frame counts in recall.
THRESHOLDS = ((0.25, 2.0), (0.5, 5.0), (5.0, 10.0))
# Parts of the video for which the median error is reported.
QUARTERS = 4


@dataclass
class TimedLocalizer:
    """A localizer that counts its queries and the processor seconds that they take."""

    inner: Localizer
    queries: int = 0
    seconds: float = 0.0

    def __post_init__(self) -> None:
        self.name, self.config = self.inner.name, self.inner.config
        self.weights_sha256 = self.inner.weights_sha256

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Prepare, not timed."""
        self.inner.prepare(sparse_map, images, cache)

    def localize(self, query: Query) -> Estimate:
        """Localize, timed."""
        begin = time.process_time()
        estimate = self.inner.localize(query)
        self.seconds += time.process_time() - begin
        self.queries += 1
        return estimate


def remove_gps(srt: Path, lost_after_s: float, gimbal: bool) -> None:
    """Replace positions of subtitles by the zeros that a drone writes without a fix."""
    blocks = srt.read_text("utf-8").split("\n\n")
    new_blocks = []
    for block in blocks:
        start = re.search(r"(\d+):(\d+):(\d+),(\d+) -->", block)
        if start is not None:
            hours, minutes, seconds, thousandths = map(int, start.groups())
            if 3600 * hours + 60 * minutes + seconds + thousandths / 1000 >= lost_after_s:
                block = re.sub(r"(latitude|longitude): [-\d.]+", r"\1: 0.000000", block)
                block = re.sub(r"\[rel_alt: [^\]]*\] ?", "", block)
                block = block if gimbal else re.sub(r"\[gb_yaw: [^\]]*\] ?", "", block)
        new_blocks.append(block)
    srt.write_text("\n\n".join(new_blocks), "utf-8")


def blank(video: Path, begin_s: float, end_s: float) -> None:
    """Blank the frames of a video between two times."""
    rate_hz = read_video(video).rate_hz
    frames = [
        np.zeros_like(frame.image) if begin_s <= frame.seconds < end_s else frame.image
        for frame in decode_frames(video)
    ]
    write_video(video, frames, rate_hz)


def report(
    name: str, located: list[ImageEstimate], truth: dict[str, Pose], localizer: TimedLocalizer
) -> dict[str, object]:
    """Return the figures of a run."""
    errors = np.full((len(located), 2), np.inf)
    for row, item in enumerate(located):
        if item.is_localized and item.estimate.cam_from_world is not None:
            found = item.estimate.cam_from_world.error_to(truth[item.name])
            errors[row] = [float(part) for part in found]
    found = np.isfinite(errors[:, 0])
    recall = {
        f"{metres:g}m_{degrees:g}deg": round(
            100 * float(((errors[:, 0] < metres) & (errors[:, 1] < degrees)).mean()), 1
        )
        for metres, degrees in THRESHOLDS
    }
    false = found & ((errors[:, 0] > 5) | (errors[:, 1] > 10))
    quarters = np.array_split(errors[:, 0], QUARTERS)
    return {
        "run": name,
        "frames": len(located),
        "found": int(found.sum()),
        "recall": recall,
        "false": int(false.sum()),
        "median_m": round(float(np.median(errors[found, 0])), 3),
        "median_deg": round(float(np.median(errors[found, 1])), 3),
        "worst_m": round(float(errors[found, 0].max()), 3),
        "median_m_of_quarters": [round(float(np.median(part)), 3) for part in quarters],
        "queries": localizer.queries,
        "seconds_a_frame": round(localizer.seconds / len(located), 2),
        "wrong": [
            f"{item.name}: {item.estimate.reason or errors[row].round(2).tolist()}"
            for row, item in enumerate(located)
            if not (errors[row, 0] < 0.5 and errors[row, 1] < 5)
        ],
    }


def main() -> None:
    """Run the measurement and print its figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("session")
    parser.add_argument("--map", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--method", default="objconnect")
    parser.add_argument("--lost-after", type=float, default=10.0)
    parser.add_argument("--no-gimbal", action="store_true")
    parser.add_argument("--black", type=float, nargs=2)
    parser.add_argument("--runs", nargs="+", default=["sequence", "frames"])
    args = parser.parse_args()
    torch.set_num_threads(1)
    flown = args.out / "flown"
    if not flown.exists():
        export(args.scene, "video", flown, [args.session])
        remove_gps(flown / f"{args.session}.SRT", args.lost_after, not args.no_gimbal)
        if args.black is not None:
            blank(flown / f"{args.session}.MP4", *args.black)
    truth = read_poses(flown / f"{args.session}-poses.txt")
    localization_map = open_map(args.map)
    configs = {"sequence": SequenceConfig(), "frames": SequenceConfig(lost_sigma_m=1e-6)}
    for name in args.runs:
        localizer = TimedLocalizer(create(args.method, {}))
        options = LocalizeOptions(
            gps_sigma_m=3.0, sequence=configs[name], undulation_m=0.0, cache=args.cache
        )
        video, out = flown / f"{args.session}.MP4", args.out / f"{name}.txt"
        located = localize_video(localization_map, video, localizer, out, options)
        figures = report(name, located, truth, localizer)
        (args.out / f"{name}-figures.json").write_text(json.dumps(figures, indent=1) + "\n")
        print(json.dumps(figures, indent=1), flush=True)


if __name__ == "__main__":
    with ProcessTuning():  # as the command line
        main()
