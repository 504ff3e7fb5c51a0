"""A board of made results: a track's description, queries and answers from a seeded generator."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmark.results.query_result import QueryResult
from benchmark.results.results import DatasetId, Results
from benchmark.tracks.description import Track, TrackPlace, write_track
from benchmark.tracks.difficulty import Difficulty, QueryRow, write_queries
from objconnect.localization.provenance import Method
from tests.benchmark.made_data import make_scored_query

CONDITIONS = ("summer-noon", "summer-dusk", "snow-dusk")
METHODS = ("sift", "pixloc", "objconnect")
STARTS = ("error=3m,5deg", "none")


def write_board(
    folder: Path,
    each: int = 8,
    places: Sequence[tuple[str, int]] = (("park", 1), ("town", 1), ("town", 2)),
    methods: Sequence[str] = METHODS,
    starts: Sequence[str] = STARTS,
) -> Path:
    """One track, uav-seasons, of ``each`` queries a flight, one flight a condition and place."""
    rng = np.random.default_rng(7)
    track = folder / "uav-seasons"
    described = []
    for preset, seed in places:
        dataset = f"{preset}-{seed}"
        sha256 = hashlib.sha256(dataset.encode()).hexdigest()
        described.append(TrackPlace(dataset=dataset, preset=preset, seed=seed, renders=(sha256,)))
        rows = _rows(rng, preset, each)
        write_queries(track / "queries" / f"{dataset}.csv", rows)
        identity = DatasetId(
            name=dataset, track="uav-sim", sha256=sha256, map_conditions=CONDITIONS[:1]
        )
        for start in starts:
            for skill, method in enumerate(methods):
                path = track / "results" / start / dataset / f"{method}.json"
                path.parent.mkdir(parents=True, exist_ok=True)
                answers = [_answer(rng, row, skill, start == "none") for row in rows]
                named = Method(name=method, config={}, weights_sha256=None)
                Results.of(named, identity, start, answers).write(path)
    described_track = Track(
        name="uav-seasons",
        title="Drones through the seasons",
        config="uav-seasons",
        places=tuple(described),
        starts=tuple(starts),
        methods=tuple(methods),
    )
    write_track(described_track, folder)
    return folder


def _rows(rng: np.random.Generator, part: str, each: int) -> list[QueryRow]:
    return [
        QueryRow(
            f"{condition}/images/{k:06d}.jpg",
            condition,
            condition,
            part,
            Difficulty(
                round(float(rng.uniform(0, 1)), 3),
                round(float(rng.uniform(0.4, 2.2)), 3),
                round(float(rng.uniform(0, 70)), 1),
                0 if number < 2 else 180,
            ),
        )
        for number, condition in enumerate(CONDITIONS)
        for k in range(each)
    ]


def _answer(rng: np.random.Generator, row: QueryRow, skill: int, lost: bool) -> QueryResult:
    """Better methods and easier queries have smaller errors; some of the hardest have none."""
    hardness = CONDITIONS.index(row.condition) + 2 * (1 - row.difficulty.overlap) + lost
    metres = 0.02 * float(np.exp(rng.normal(1.2 * hardness - skill, 1)))
    name, condition = row.name, row.condition
    if metres > 30:
        return make_scored_query(name, None, condition, group=condition)
    return make_scored_query(
        name,
        metres,
        condition,
        group=condition,
        r_err_deg=metres / 2,
        sigma_t_m=None if skill == 0 else metres * float(rng.uniform(0.5, 2)),
        nees=None if skill == 0 else float(rng.chisquare(6)),
        seconds={"total": 0.1 + skill / 10},
    )
