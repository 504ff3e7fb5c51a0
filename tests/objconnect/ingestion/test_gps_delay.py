"""A flight to and fro whose receiver is known to lag, and a real one whose receiver does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from objconnect.ingestion.gps_delay import estimate_motions, find_delay, undo_delay
from objconnect.scene.flights.textfiles import read_gps, read_poses
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.storage.exif import read_exif

Array = NDArray[np.float64]
Placed = dict[str, Array]

LINES, LONG, SPEED, EVERY = 8, 9, 5.0, 2.0
NAMES = tuple(f"{k:03d}" for k in range(LINES * LONG))
TIMES = {name: EVERY * k for k, name in enumerate(NAMES)}


def survey(lines: int = LINES) -> Placed:
    """Cameras of lines north and south, 15 m apart."""
    centres = {}
    for k, name in enumerate(NAMES[: lines * LONG]):
        line, step = divmod(k, LONG)
        north = SPEED * EVERY * (step if line % 2 == 0 else LONG - 1 - step)
        centres[name] = np.array([15.0 * line, north, 40.0])
    return centres


def receive(centres: Placed, lag: float, drift: float) -> Placed:
    """Fixes of a receiver that lags, is off by a constant, and drifts from line to line."""
    rng = np.random.default_rng(3)
    moving = estimate_motions(sorted(centres), centres, TIMES)
    per_line = rng.normal(0, drift, (LINES, 3))
    noise = {name: rng.normal(0, 0.3, 3) for name in centres}
    return {
        name: centres[name]
        + (3.0, -2.0, 1.0)
        - lag * moving[name].velocity
        + per_line[moving[name].line]
        + noise[name]
        for name in centres
    }


def lag_of(centres: Placed, fixes: Placed) -> float:
    return find_delay(estimate_motions(sorted(centres), centres, TIMES), centres, fixes)


@pytest.mark.parametrize("lag", [1.7, -0.6])
def test_a_known_lag_is_found(lag: float) -> None:
    centres = survey()
    fixes = receive(centres, lag, drift=0.5)
    assert lag_of(centres, fixes) == pytest.approx(lag, abs=0.15)
    # Whole seconds, as most cameras write them, change little.
    coarse = {name: float(round(time / 2.13 * 2.0)) for name, time in TIMES.items()}
    moving = estimate_motions(sorted(centres), centres, coarse)
    assert find_delay(moving, centres, fixes) == pytest.approx(lag * 2.0 / 2.13, abs=0.3)


def test_positions_without_the_lag_are_better() -> None:
    centres = survey()
    fixes = receive(centres, 1.7, drift=0.5)
    motions = estimate_motions(sorted(centres), centres, TIMES)
    undone = undo_delay(fixes, motions, lag_of(centres, fixes))

    def spread(places: Placed) -> float:
        off = np.array([places[name] - centres[name] for name in centres])
        return float(np.sqrt(np.square(off - off.mean(0)).sum(1).mean()))

    assert spread(undone) < 1.3 < 8 < spread(fixes)


def test_drift_is_no_lag() -> None:
    """As far off from line to line as a lag of a second would be."""
    centres = survey()
    assert lag_of(centres, receive(centres, 0.0, drift=5.0)) == 0


def test_nothing_is_said_where_nothing_can_be_told() -> None:
    few = survey(lines=5)
    assert lag_of(few, receive(few, 1.7, drift=0.1)) == 0
    straight = {name: np.array([0, SPEED * TIMES[name], 40.0]) for name in NAMES}
    assert lag_of(straight, receive(straight, 1.7, drift=0.1)) == 0
    centres = survey()
    assert find_delay(estimate_motions(sorted(centres), centres, {}), centres, centres) == 0
    at_once = dict.fromkeys(NAMES, 5.0)
    assert estimate_motions(sorted(centres), centres, at_once) == {}


def test_a_real_receiver_that_lags(flights: Path) -> None:
    """By two seconds; what is left is drift."""
    path = flights / "caliterra"
    model = read_model(path / "sparse" / "map")
    centres = {name: model.images[name].centre for name in model.names}
    for name, pose in read_poses(path / "reference_poses.txt").items():
        centres[name] = pose.centre().numpy()
    fixes = read_gps(path / "gps.csv")
    times = {}
    for name in centres:
        time = read_exif(path / "photos" / name).time
        assert time is not None
        times[name] = time.timestamp()
    lag = find_delay(estimate_motions(sorted(centres), centres, times), centres, fixes)
    assert lag == pytest.approx(2.1, abs=0.3)
