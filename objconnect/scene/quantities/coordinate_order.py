"""The order of latitude and longitude in a drone's track, found by plausibility checks."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Final, Literal

from objconnect.scene.quantities.reading import Reading, known, unknown

Order = Literal["latitude", "longitude"]
"""The quantity of the first number of a pair."""
Pair = tuple[float, float]

ORDERS: Final[tuple[Order, Order]] = ("latitude", "longitude")
REACH_M: Final = 50_000.0
"""Largest distance of a drone from its map or its take-off."""
# No drone is faster (m/s).
_MAX_SPEED: Final = 100.0
# Tolerance of a stated speed or distance: a share, and a length (m).
_TOLERANCE_SHARE: Final = 0.1
_TOLERANCE_M: Final = 15.0
# Length of a degree along the equator.
_DEGREE_M: Final = 111_320.0
# Tolerance of a position against the median of its neighbours, in addition to the distance that a
# drone can fly meanwhile (m), and the number of neighbours on each side.
_JUMP_M: Final = 200.0
_NEIGHBOURS: Final = 5
# Length of the steps of a track whose speed is computed, s.
_STEP_S: Final = 1.0


@dataclass(frozen=True)
class PairedTrack:
    """Pairs of coordinates whose order the file does not state.

    Attributes:
        seconds: time of each pair.
        pairs: degrees, in the order of times.
        home_pairs: take-off positions, in the same unknown order as each of ``pairs``.
        home_lat_lons: take-off positions (latitude, longitude) whose order the letters N, S, E or
            W state.
        distances: index of a pair and its stated distance from take-off, metres.
        speeds: stated speeds over ground, m/s; empty unless every pair has one.
    """

    seconds: Sequence[float]
    pairs: Sequence[Pair]
    home_pairs: Sequence[Pair] = ()
    home_lat_lons: Sequence[Pair] = ()
    distances: Sequence[tuple[int, float]] = ()
    speeds: Sequence[float] = field(default=())


def infer_order(track: PairedTrack, map_place: Pair | None = None) -> Reading[Order]:
    """Return the quantity of the first number of a track's pairs.

    Each check excludes orders: latitudes beyond 90 degrees, a map or a take-off out of reach, a
    distance from take-off that differs from the stated one, and a speed above the stated ones or,
    without these, above any drone's.

    Args:
        track: track of at least one pair.
        map_place: latitude and longitude of the map, degrees; None if unknown.
    """
    source = "GPS"
    if all(first == second for first, second in track.pairs):
        return known("latitude", source)
    checks: dict[str, Callable[[Order], bool]] = {
        "is on earth": lambda order: _is_on_earth(track, order),
        f"is within {REACH_M / 1000:.0f} km of the map": lambda order: _is_near(
            track, order, map_place
        ),
        "agrees with HOME": lambda order: _agrees_with_home(track, order),
    }
    orders: list[Order] = list(ORDERS)
    for check, holds in checks.items():
        orders = [order for order in orders if holds(order)]
        if not orders:
            return unknown(source, f"no order of the numbers of GPS(a, b) {check}")
    for select in (_select_by_distance, _select_by_speed):
        orders = select(track, orders) or orders
    if len(orders) == 1:
        return known(orders[0], source)
    return unknown(source, "the order of latitude and longitude in GPS(a, b) is unknown")


def to_lat_lon(pair: Pair, order: Order) -> Pair:
    """Return latitude and longitude of a pair, degrees."""
    return pair if order == "latitude" else (pair[1], pair[0])


def ground_distance(first: Pair, second: Pair) -> float:
    """Return the distance of two places (latitude, longitude) on a sphere, metres."""
    a, b = map(math.radians, first), map(math.radians, second)
    (lat_a, lon_a), (lat_b, lon_b) = a, b
    half = (
        math.sin((lat_b - lat_a) / 2) ** 2
        + math.cos(lat_a) * math.cos(lat_b) * math.sin((lon_b - lon_a) / 2) ** 2
    )
    return 2 * math.degrees(math.asin(min(1.0, math.sqrt(half)))) * _DEGREE_M


def _median_pair(pairs: Collection[Pair]) -> Pair:
    return median(pair[0] for pair in pairs), median(pair[1] for pair in pairs)


def _is_on_earth(track: PairedTrack, order: Order) -> bool:
    places = [to_lat_lon(pair, order) for pair in (*track.pairs, *track.home_pairs)]
    return all(abs(latitude) <= 90 and abs(longitude) <= 180 for latitude, longitude in places)


def _is_near(track: PairedTrack, order: Order, map_place: Pair | None) -> bool:
    if map_place is None:
        return True
    return ground_distance(to_lat_lon(_median_pair(track.pairs), order), map_place) <= REACH_M


def _agrees_with_home(track: PairedTrack, order: Order) -> bool:
    position = to_lat_lon(_median_pair(track.pairs), order)
    homes = [*track.home_lat_lons, *(to_lat_lon(home, order) for home in track.home_pairs)]
    return all(ground_distance(position, home) <= REACH_M for home in homes)


def _select_by_distance(track: PairedTrack, orders: Sequence[Order]) -> list[Order]:
    """Return the orders whose distances from take-off match the stated ones."""
    if not track.distances or not (track.home_pairs or track.home_lat_lons):
        return []
    tolerance = max(
        _TOLERANCE_M, _TOLERANCE_SHARE * median(stated for _, stated in track.distances)
    )
    misfits: dict[Order, float] = {}
    for order in orders:
        homes = [*track.home_lat_lons, *(to_lat_lon(home, order) for home in track.home_pairs)]
        misfits[order] = median(
            min(
                abs(ground_distance(to_lat_lon(track.pairs[row], order), home) - stated)
                for home in homes
            )
            for row, stated in track.distances
        )
    fitting = [order for order in orders if misfits[order] <= tolerance]
    excluded = [order for order in orders if misfits[order] > 2 * tolerance]
    return fitting if len(fitting) + len(excluded) == len(orders) else []


def _select_by_speed(track: PairedTrack, orders: Sequence[Order]) -> list[Order]:
    """Return the orders in which the track is not faster than stated, or than a drone can fly."""
    max_speed = (1 + 2 * _TOLERANCE_SHARE) * max(track.speeds) if track.speeds else _MAX_SPEED
    steps, last = [], 0
    for row, seconds in enumerate(track.seconds):
        if seconds - track.seconds[last] >= _STEP_S:
            steps.append((last, row))
            last = row
    if not steps:
        return []

    def is_plausible(order: Order) -> bool:
        too_fast = 0
        for first, second in steps:
            ends = (to_lat_lon(track.pairs[row], order) for row in (first, second))
            allowed = max_speed * (track.seconds[second] - track.seconds[first]) + _TOLERANCE_M
            too_fast += ground_distance(*ends) > allowed
        return 2 * too_fast < len(steps)

    return [order for order in orders if is_plausible(order)]


def drop_jumps(seconds: Sequence[float], places: Sequence[Pair | None]) -> list[Pair | None]:
    """Return the positions of a track with None for those that no drone can have reached.

    Each position is compared with the median of up to five neighbours on each side, and with the
    median of the track.

    Args:
        seconds: times, ascending.
        places: latitude and longitude, degrees; None if unknown.
    """
    known_rows = [row for row, place in enumerate(places) if place is not None]
    known_places = [place for place in places if place is not None]
    plausible = list(places)
    if len(known_rows) < 3:
        return plausible
    track_middle = _median_pair(known_places)
    for k, row in enumerate(known_rows):
        window = range(max(0, k - _NEIGHBOURS), min(len(known_rows), k + _NEIGHBOURS + 1))
        span = seconds[known_rows[window[-1]]] - seconds[known_rows[window[0]]]
        middle = _median_pair([known_places[other] for other in window])
        position = known_places[k]
        if (
            ground_distance(position, middle) > _JUMP_M + _MAX_SPEED * span
            or ground_distance(position, track_middle) > REACH_M
        ):
            plausible[row] = None
    return plausible
