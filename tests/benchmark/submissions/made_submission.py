"""A submission with the poses that ``objconnect`` found on a track that the repository keeps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from benchmark.results.results_files import load
from benchmark.tracks.description import TRACKS_FOLDER, load_track
from objconnect.scene.flights.textfiles import pose_line
from objconnect.scene.storage.answers import pose_of

TRACK = "uav-small"
DATASET = "small-1"
STORED = TRACKS_FOLDER / TRACK / "results" / "none" / DATASET / "objconnect.json.xz"


def make_card(**changed: Any) -> dict[str, Any]:
    (place,) = load_track(TRACK).places
    return {
        "track": TRACK,
        "method": "theirs",
        "authors": "A. Author",
        "description": "Poses of objconnect under another name",
        "trained_on": "nothing",
        "start": "none",
        "datasets": {DATASET: place.renders[0]},
    } | changed


def write_submission(folder: Path, lines: list[str] | None = None, **changed: Any) -> Path:
    """Write a submission with the poses that ``objconnect`` found."""
    answers = {
        query.name: pose_of(query.cam_from_world)
        for query in load(STORED).queries
        if query.cam_from_world is not None and query.status == "ok"
    }
    (folder / "poses").mkdir(parents=True)
    lines = lines or [pose_line(name, pose, 9) for name, pose in answers.items()]
    (folder / "poses" / f"{DATASET}.txt").write_text("\n".join(lines) + "\n")
    (folder / "card.yaml").write_text(yaml.safe_dump(make_card(**changed)))
    return folder
