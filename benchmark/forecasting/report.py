"""The report of a forecast: waypoints, a verdict per season, weak stretches, and advice."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, Literal

from benchmark.forecasting.calibration import Calibration
from benchmark.forecasting.config import ForecastConfig
from objconnect.localization.provenance import Environment, Method
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.storage.records import Record

Cause = Literal["few points", "appearance"]
Verdict = Literal["holds", "gaps", "fails"]

SCHEMA = "objconnect forecast 2"
FEW_POINTS: Final = 40
"""If fewer map points are in view, more photographs for the map would help."""

CAUSES: Mapping[Cause, str] = {
    "few points": "few points of the map are in view: photograph the ground there for the map",
    "appearance": "the map has points there, but the season hides them: fly the map again in a "
    "season or light nearer to this one, fly higher, or choose another method",
}
VERDICTS: Mapping[Verdict, str] = {
    "holds": "fixes all along",
    "gaps": "fixes with gaps that are too long",
    "fails": "too few fixes to navigate by",
}


class Outlook(Record):
    """The forecast for a waypoint in one season.

    Attributes:
        probability: probability of a fix.
        false_risk: probability of a false fix.
        sigma_across_m: expected horizontal standard deviation of a fix relative to the map, metres;
            None if no view of the waypoint or its neighbours had a fix with one.
        sigma_up_m: the vertical one.
        found: number of views of this waypoint with a fix.
        views: number of its views.
        cause: why the probability is below ``ForecastConfig.weak``; None if it is not.
    """

    probability: float
    false_risk: float
    sigma_across_m: float | None
    sigma_up_m: float | None
    found: int
    views: int
    cause: Cause | None


class Waypoint(Record):
    """A waypoint with its outlooks.

    Attributes:
        number: from 1, in flying order.
        enu_m: position in the map's world: east, north, up, metres.
        longitude: degrees.
        latitude: degrees.
        altitude_m: height above the ellipsoid, metres.
        along_m: distance flown from the first waypoint, metres.
        points: number of map points in view, geometric mean over the views.
        seasons: outlook by season.
    """

    number: int
    enu_m: tuple[float, float, float]
    longitude: float
    latitude: float
    altitude_m: float
    along_m: float
    points: float
    seasons: dict[str, Outlook]


class Stretch(Record):
    """Successive waypoints at which a fix is unlikely.

    Attributes:
        first: number of the first waypoint, counted from 1.
        last: number of the last waypoint, counted from 1.
        gap_m: distance flown between the likely fixes before and after the stretch, metres. A
            stretch at an end of the flight has one of them only: the gap reaches to that end.
        probability: mean probability of a fix at the waypoints.
        cause: the cause at most of the waypoints.
    """

    first: int
    last: int
    gap_m: float
    probability: float
    cause: Cause


class Season(Record):
    """The forecast for a flight in one season.

    Attributes:
        name: condition.
        verdict: whether the flight can rely on its fixes.
        share: mean probability of a fix.
        lowest: lowest probability.
        longest_gap_m: longest gap of a weak stretch, metres; without one, the longest distance
            between successive waypoints.
        false_risk: mean probability of a false fix.
        sigma_across_m: median of the waypoints' horizontal standard deviations; None without any.
        sigma_up_m: the vertical one.
        stretches: weak stretches, the longest gap first.
    """

    name: str
    verdict: Verdict
    share: float
    lowest: float
    longest_gap_m: float
    false_risk: float
    sigma_across_m: float | None
    sigma_up_m: float | None
    stretches: tuple[Stretch, ...]


class PhotographRequest(Record):
    """A part of the flight where more map photographs would help.

    Attributes:
        first: number of its first waypoint, counted from 1.
        last: number of its last waypoint, counted from 1.
        points: mean number of map points in view.
        lost: expected number of missing fixes there, over all seasons.
        longitude: longitude of its middle, degrees.
        latitude: latitude of its middle, degrees.
    """

    first: int
    last: int
    points: float
    lost: float
    longitude: float
    latitude: float


class Forecast(Record):
    """The report of a forecast.

    Attributes:
        file: format of the file.
        scene: name of the scene of the map.
        scene_sha256: digest of its map.
        flight: name of the mission plan, or the flight of ``simulate``.
        flight_sha256: digest of the mission plan; None for other flights.
        twin: name of the given rendered copy of the site; None if it was built from the scene.
        method: the method and its configuration.
        config: options of the forecast.
        calibration: calibration of the probabilities.
        environment: versions of the packages.
        notes: notes on the twin and on the probabilities.
        seasons: forecasts by season, in the requested order.
        waypoints: waypoints in flying order.
        photographs: where more map photographs would help, the largest loss of fixes first.
        views: every view: season, waypoint, answer and errors.
    """

    file: Literal["objconnect forecast 2"] = "objconnect forecast 2"
    scene: str
    scene_sha256: str
    flight: str
    flight_sha256: str | None
    twin: str | None
    method: Method
    config: ForecastConfig
    calibration: Calibration
    environment: Environment
    notes: tuple[str, ...]
    seasons: tuple[Season, ...]
    waypoints: tuple[Waypoint, ...]
    photographs: tuple[PhotographRequest, ...]
    views: tuple[dict[str, Any], ...]

    def text(self) -> str:
        """Return the verdicts as lines."""
        return "\n".join(self._lines())

    def as_dict(self) -> dict[str, Any]:
        """Return the report without its single views."""
        return self.model_dump(mode="json", exclude={"views"})

    def _lines(self) -> Iterator[str]:
        yield f"{for_terminal(self.flight)} by {self.method.name}: {len(self.waypoints)} waypoints"
        for season in self.seasons:
            metres = season.sigma_across_m
            sigma = "" if metres is None else f", horizontal sigma {metres:.2f} m within the map"
            yield (
                f"{season.name}: {VERDICTS[season.verdict]}; a fix at {100 * season.share:.0f} % "
                f"of the waypoints, longest gap {season.longest_gap_m:.0f} m, false fixes "
                f"{100 * season.false_risk:.1f} %{sigma}"
            )
        for request in self.photographs:
            first, last = request.first, request.last
            where = f"waypoint {first}" if first == last else f"waypoints {first} to {last}"
            yield f"photograph {where} for the map: {request.points:.0f} points in view"
        yield from self.notes


def weak_stretches(
    waypoints: Sequence[Waypoint], season: str, config: ForecastConfig
) -> tuple[Stretch, ...]:
    """Return the weak stretches of a flight in a season, the longest gap first."""
    stretches = []
    for first, last in find_runs([w.seasons[season].probability < config.weak for w in waypoints]):
        part = [w.seasons[season] for w in waypoints[first : last + 1]]
        before, after = max(first - 1, 0), min(last + 1, len(waypoints) - 1)
        few = sum(outlook.cause == "few points" for outlook in part)
        stretches.append(
            Stretch(
                first=first + 1,
                last=last + 1,
                gap_m=round(waypoints[after].along_m - waypoints[before].along_m, 1),
                probability=round(sum(o.probability for o in part) / len(part), 4),
                cause="few points" if 2 * few > len(part) else "appearance",
            )
        )
    return tuple(sorted(stretches, key=lambda stretch: -stretch.gap_m))


def request_photographs(
    waypoints: Sequence[Waypoint], config: ForecastConfig
) -> tuple[PhotographRequest, ...]:
    """Return where few map points are in view and a fix is unlikely in some season."""

    def is_wanted(waypoint: Waypoint) -> bool:
        weakest = min(outlook.probability for outlook in waypoint.seasons.values())
        return waypoint.points < FEW_POINTS and weakest < config.weak

    requests = []
    for first, last in find_runs([is_wanted(w) for w in waypoints]):
        part = waypoints[first : last + 1]
        middle = part[len(part) // 2]
        lost = sum(1 - o.probability for w in part for o in w.seasons.values())
        requests.append(
            PhotographRequest(
                first=first + 1,
                last=last + 1,
                points=round(sum(w.points for w in part) / len(part), 1),
                lost=round(lost, 2),
                longitude=middle.longitude,
                latitude=middle.latitude,
            )
        )
    return tuple(sorted(requests, key=lambda request: -request.lost))


def verdict_of(share: float, longest_gap_m: float, config: ForecastConfig) -> Verdict:
    """Return whether a flight can rely on its fixes."""
    if share < config.weak:
        return "fails"
    return "gaps" if longest_gap_m > config.gap_m else "holds"


def find_runs(flags: Sequence[bool]) -> list[tuple[int, int]]:
    """Return the first and last index of each run of true values."""
    runs: list[tuple[int, int]] = []
    for k, flag in enumerate(flags):
        if flag and runs and runs[-1][1] == k - 1:
            runs[-1] = (runs[-1][0], k)
        elif flag:
            runs.append((k, k))
    return runs
