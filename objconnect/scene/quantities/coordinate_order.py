"""Which number of a pair of coordinates is the latitude, told by checks of a drone's track."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Final, Literal

from objconnect.scene.quantities.reading import Reading, known, unknown

Order = Literal["latitude", "longitude"]
"""What the first number of a pair is."""
Pair = tuple[float, float]

ORDERS: Final[tuple[Order, Order]] = ("latitude", "longitude")
REACH_M: Final = 50_000.0
"""A drone is not further from its map or its place of take-off."""
# No drone is faster (m/s).
_FASTEST: Final = 100.0
# A stated speed or distance may differ from the track's by this share, and by this length (m).
_SHARE: Final = 0.1
_SLACK_M: Final = 15.0
_DEGREE_M: Final = 111_320.0
# Steps of a track over which its speed is taken, s.
_STEP_S: Final = 1.0


@dataclass(frozen=True)
class PairedTrack:
    """Pairs of coordinates whose order is not written.

    Attributes:
        seconds: Time of each pair.
        pairs: Degrees, in the order of times.
        homes: Places of take-off in the order of the pairs, if the file tells them.
        home_places: Places of take-off as latitude and longitude, where letters tell.
        distances: For some pairs, their index and the stated distance from take-off, metres.
        speeds: Stated speeds over ground, m/s; empty unless every pair has one.
    """

    seconds: Sequence[float]
    pairs: Sequence[Pair]
    homes: Sequence[Pair] = ()
    home_places: Sequence[Pair] = ()
    distances: Sequence[tuple[int, float]] = ()
    speeds: Sequence[float] = field(default=())


def order_of(track: PairedTrack, near: Pair | None = None) -> Reading[Order]:
    """Return what the first number of a track's pairs is.

    Each check leaves out orders that cannot be: numbers beyond 90 degrees, a map or a place of
    take-off out of reach, a speed that no drone has or that is not the stated one, and stated
    distances from take-off.

    Args:
        track: At least one pair.
        near: Latitude and longitude of the map, degrees; None where that is not known.
    """
    source = "GPS"
    if all(first == second for first, second in track.pairs):
        return known("latitude", source)
    checks: dict[str, Callable[[Order], bool]] = {
        "is on earth": lambda order: _is_on_earth(track, order),
        f"is within {REACH_M / 1000:.0f} km of the map": lambda order: _is_near(track, order, near),
        "agrees with HOME": lambda order: _agrees_with_home(track, order),
    }
    left: list[Order] = list(ORDERS)
    for check, holds in checks.items():
        left = [order for order in left if holds(order)]
        if not left:
            return unknown(source, f"no order of the numbers of GPS(a, b) {check}")
    for decide in (_by_distance, _by_speed):
        left = decide(track, left) or left
    if len(left) == 1:
        return known(left[0], source)
    return unknown(source, "which number of GPS(a, b) is the latitude is not told")


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


def _middle(pairs: Collection[Pair]) -> Pair:
    return median(pair[0] for pair in pairs), median(pair[1] for pair in pairs)


def _is_on_earth(track: PairedTrack, order: Order) -> bool:
    places = [to_lat_lon(pair, order) for pair in (*track.pairs, *track.homes)]
    return all(abs(latitude) <= 90 and abs(longitude) <= 180 for latitude, longitude in places)


def _is_near(track: PairedTrack, order: Order, near: Pair | None) -> bool:
    if near is None:
        return True
    return ground_distance(to_lat_lon(_middle(track.pairs), order), near) <= REACH_M


def _agrees_with_home(track: PairedTrack, order: Order) -> bool:
    here = to_lat_lon(_middle(track.pairs), order)
    homes = [*track.home_places, *(to_lat_lon(home, order) for home in track.homes)]
    return all(ground_distance(here, home) <= REACH_M for home in homes)


def _by_distance(track: PairedTrack, orders: Sequence[Order]) -> list[Order]:
    """Return the orders in which the pairs are as far from take-off as is stated."""
    if not track.distances or not (track.homes or track.home_places):
        return []
    tolerance = max(_SLACK_M, _SHARE * median(stated for _, stated in track.distances))
    misfits: dict[Order, float] = {}
    for order in orders:
        homes = [*track.home_places, *(to_lat_lon(home, order) for home in track.homes)]
        misfits[order] = median(
            min(
                abs(ground_distance(to_lat_lon(track.pairs[row], order), home) - said)
                for home in homes
            )
            for row, said in track.distances
        )
    fitting = [order for order in orders if misfits[order] <= tolerance]
    others = [order for order in orders if misfits[order] > 2 * tolerance]
    return fitting if len(fitting) + len(others) == len(orders) else []


def _by_speed(track: PairedTrack, orders: Sequence[Order]) -> list[Order]:
    """Return the orders in which the track is not faster than a drone, or than it says to be."""
    most = (1 + 2 * _SHARE) * max(track.speeds) if track.speeds else _FASTEST
    steps, last = [], 0
    for row, seconds in enumerate(track.seconds):
        if seconds - track.seconds[last] >= _STEP_S:
            steps.append((last, row))
            last = row
    if not steps:
        return []

    def is_slow(order: Order) -> bool:
        fast = 0
        for first, second in steps:
            ends = (to_lat_lon(track.pairs[row], order) for row in (first, second))
            allowed = most * (track.seconds[second] - track.seconds[first]) + _SLACK_M
            fast += ground_distance(*ends) > allowed
        return 2 * fast < len(steps)

    return [order for order in orders if is_slow(order)]


def without_jumps(seconds: Sequence[float], places: Sequence[Pair | None]) -> list[Pair | None]:
    """Return the places of a track without those to which no drone can have flown.

    A place is compared with the middle of the five before and after it, and with that of the whole
    track.

    Args:
        seconds: Times, ascending.
        places: Latitude and longitude, degrees; None where there is none.
    """
    fixed = [row for row, place in enumerate(places) if place is not None]
    known_places = [place for place in places if place is not None]
    left = list(places)
    if len(fixed) < 3:
        return left
    whole = _middle(known_places)
    for at, row in enumerate(fixed):
        near = range(max(0, at - 5), min(len(fixed), at + 6))
        span = seconds[fixed[near[-1]]] - seconds[fixed[near[0]]]
        middle = _middle([known_places[other] for other in near])
        here = known_places[at]
        if (
            ground_distance(here, middle) > 200 + _FASTEST * span
            or ground_distance(here, whole) > REACH_M
        ):
            left[row] = None
    return left
