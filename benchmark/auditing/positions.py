"""Check of stated positions against the GPS positions in the photographs' EXIF.

Poses in a world of their own are compared up to a similarity, whose scale shows whether the world
is in metres. Positions on earth are compared directly.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.auditing.findings import Finding, right, unknown, wrong
from benchmark.auditing.photograph_order import SHIFTS
from benchmark.auditing.statements import Stated
from objconnect.ingestion.georegister import fit_similarity
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic, is_on_earth, median_place
from objconnect.scene.geometry.robust import SIGMA_OF_MEDIAN
from objconnect.scene.storage.images import Exif

Array = NDArray[np.float64]

LATLON = "latitudes and longitudes are those of the photographs"
FOLLOW = "positions follow the photographs' GPS"
SCALE = "the world is in metres"
EAST_NORTH = "positions lie where the photographs' GPS is"
HEIGHTS = "heights are those of the photographs"

FEWEST = 3
# Positions follow GPS if the residual is below this share of the flight's extent.
_FOLLOWS = 0.3
# Another reading of positions explains GPS if the residual shrinks to this share.
_SHRINKS = 0.2
# Scales within this of one are metric; errors of GPS and timing change it by a few per cent.
_METRIC = 0.05
# Uncertainty of the scale above which it is unknown.
_VAGUE = 0.1
# Smallest constant offset (m) that is not an error of the receiver.
_OFFSET_M = 6.0
# Largest scatter (m) of the photographs' altitudes that still allows a comparison.
_SCATTER_M = 8.0
_FEET = 0.3048
# Positions farther than this (m) from the photographs' are elsewhere; the earth curves between.
_ELSEWHERE_M = 20_000.0


@dataclass(frozen=True)
class _Latlon:
    """A frequent mistake in latitudes and longitudes."""

    fault: str
    looks: str
    read: Callable[[Array], Array]


_LATLONS = (
    _Latlon("latlon-swapped", "latitude and longitude are swapped", lambda p: p[:, [1, 0, 2]]),
    _Latlon(
        "latlon-radians",
        "latitude and longitude are radians where degrees are expected",
        lambda p: np.column_stack([np.degrees(p[:, :2]), p[:, 2]]),
    ),
    _Latlon("longitude-sign", "the sign of the longitude is lost", lambda p: p * [1, -1, 1]),
    _Latlon("latitude-sign", "the sign of the latitude is lost", lambda p: p * [-1, 1, 1]),
)


@dataclass(frozen=True)
class _Compared:
    """Stated and measured positions of the n photographs that have both, metres.

    Attributes:
        stated: (n, 3).
        measured: (n, 3) east, north, up.
        absolute: whether both are in the same frame; else the stated ones have their own world.
        high: whether the height of each was measured, (n,); else it is the stated one.
    """

    stated: Array
    measured: Array
    absolute: bool
    high: NDArray[np.bool_]

    @property
    def extent(self) -> float:
        """Root mean square horizontal distance of the measured positions from their middle."""
        off = self.measured[:, :2] - self.measured[:, :2].mean(0)
        return float(np.sqrt((off**2).sum(1).mean()))


def check_positions(
    stated: Stated, positions: Array | None, exif: Sequence[Exif | None], named: bool
) -> tuple[list[Finding], Array]:
    """Check positions against the photographs' GPS.

    Returns:
        The findings, and east and north (m) of the photographs as stated and as measured, (n, 4).

    Args:
        stated: the data set.
        positions: camera centres (N, 3) in its world, in the right convention; None for a table of
            geodetic positions.
        exif: metadata of each photograph; None if it cannot be read.
        named: whether the photographs already showed that names and poses belong together; a
            delayed GPS is then not taken for wrong names.
    """
    findings: list[Finding] = []
    places = [None if e is None else e.position for e in exif]
    there = np.array([place is not None for place in places])
    high = np.array([place is not None and not np.isnan(place.altitude) for place in places])
    if stated.places is None:
        there = high  # poses in a world of their own are compared in three dimensions
    if there.sum() >= FEWEST:
        read = stated.places
        known = _with_heights(places, there, read)
        if read is not None:
            finding, read = _check_latlon(read[there], known)
            findings.append(finding)
        own = None if positions is None else positions[there]
        compared = _on_earth(known, read, own, high[there])
    elif positions is not None and stated.measured is not None:
        there = np.isfinite(stated.measured).all(1)
        every = np.ones(int(there.sum()), bool)
        compared = _Compared(positions[there], stated.measured[there], True, every)
    else:
        compared = None
    if compared is None or len(compared.measured) < FEWEST:
        return [*findings, _no_gps(stated, int(there.sum()))], np.zeros((0, 4))
    findings += _compare(compared, named, positions is not None)
    return findings, _plan(compared)


def _with_heights(
    places: Sequence[Geodetic | None], there: NDArray[np.bool_], read: Array | None
) -> list[Geodetic]:
    """Return the measured places, with stated heights for those without an altitude.

    The stated heights are shifted by their median difference to the measured ones, so that another
    height system causes no step between the two.
    """
    known = [(row, place) for row, place in enumerate(places) if place is not None and there[row]]
    if read is None:
        return [place for _, place in known]
    up = [place.altitude - float(read[row, 2]) for row, place in known]
    known_up = [each for each in up if not np.isnan(each)]
    above = float(np.median(known_up)) if known_up else 0.0
    return [
        place._replace(altitude=float(read[row, 2]) + above) if np.isnan(place.altitude) else place
        for row, place in known
    ]


def _plan(compared: _Compared) -> Array:
    """Return the plan to draw; a world of its own is first aligned to the measured positions."""
    stated = compared.stated
    if not compared.absolute:
        fitted, _ = _fit(stated, compared.measured)
        stated = stated @ fitted[:, :3].T + fitted[:, 3]
    return np.column_stack([stated[:, :2], compared.measured[:, :2]])


def _no_gps(stated: Stated, count: int) -> Finding:
    """Return the finding without GPS; coordinates that are nowhere on earth are still wrong."""
    if stated.places is not None:
        off = [not is_on_earth(Geodetic(*row)) for row in stated.places.tolist()]
        if any(off):
            name, row = stated.names[off.index(True)], stated.places[off.index(True)]
            swapped = is_on_earth(Geodetic(float(row[1]), float(row[0]), float(row[2])))
            fault, looks = (
                ("latlon-swapped", "latitude and longitude are swapped")
                if swapped
                else ("not-on-earth", "they are not degrees")
            )
            detail = f"{name} is at {row[0]:g}, {row[1]:g}, which is not on earth: {looks}"
            return wrong(LATLON, fault, detail)
    what = "a GPS position" if stated.places is not None else "a GPS position with its altitude"
    return unknown(FOLLOW, f"{count} photographs have {what}, {FEWEST} are needed")


def _check_latlon(places: Array, known: Sequence[Geodetic]) -> tuple[Finding, Array]:
    """Check latitudes and longitudes, and return them corrected."""
    origin = median_place(known)
    measured = np.array([enu_from_geodetic(place, origin) for place in known])

    def distance(read: Array) -> float:
        enu = np.array([enu_from_geodetic(Geodetic(*row), origin) for row in read.tolist()])
        return float(np.median(np.linalg.norm((enu - measured)[:, :2], axis=1)))

    ours = distance(places)
    best, reading = min(
        ((distance(one.read(places)), one) for one in _LATLONS), key=lambda item: item[0]
    )
    if best < _SHRINKS * ours and ours > 1000:
        detail = f"{reading.looks}: so read they are {best:.0f} m from GPS, as stated {ours:.4g} m"
        finding = wrong(LATLON, reading.fault, detail, metres=ours, explained_metres=best)
        return finding, reading.read(places)
    if ours > _ELSEWHERE_M:
        why = f"they are {ours / 1000:.4g} km from GPS, however they are read"
        return unknown(LATLON, why, metres=ours), places
    return right(LATLON, f"median {ours:.1f} m from GPS", metres=ours), places


def _on_earth(
    known: Sequence[Geodetic],
    places: Array | None,
    positions: Array | None,
    high: NDArray[np.bool_],
) -> _Compared:
    origin = median_place(known)
    measured = np.array([enu_from_geodetic(place, origin) for place in known])
    if places is not None:
        rows = [enu_from_geodetic(Geodetic(*row), origin) for row in places.tolist()]
        return _Compared(np.array(rows), measured, True, high)
    assert positions is not None
    return _Compared(positions, measured, False, high)


def _compare(compared: _Compared, named: bool, posed: bool) -> Iterator[Finding]:
    extent = compared.extent
    if extent < 1.0:
        yield unknown(FOLLOW, f"the photographs were taken within {extent:.1f} m")
        return
    fitted, residual = _fit(compared.stated, compared.measured)
    scale = float(np.cbrt(max(np.linalg.det(fitted[:, :3]), 0.0)))
    if residual > _FOLLOWS * extent:
        yield _explain(compared, residual, named)
        return
    yield right(
        FOLLOW,
        f"{residual:.2f} m (median) from GPS after the best motion and scale, over {extent:.0f} m",
        residual_m=residual,
    )
    vague = 3 * residual / (extent * np.sqrt(len(compared.stated)))
    if abs(np.log(max(scale, 1e-9))) > max(_METRIC, vague):
        looks = "it is in feet" if abs(scale / _FEET - 1) < _METRIC else "it is not metric"
        detail = f"one unit is {scale:.4g} m: {looks}"
        yield wrong(SCALE, "scale", detail, scale=scale)
    elif vague > _VAGUE:
        yield unknown(SCALE, f"GPS determines the scale to {vague:.0%} only", scale=scale)
    else:
        yield right(SCALE, f"one unit is {scale:.3f} m by GPS", scale=scale)
    if compared.absolute:
        yield from _offsets(compared)
    elif posed:
        yield unknown(HEIGHTS, "the data set does not state where its world is on earth")


def _fit(stated: Array, measured: Array) -> tuple[Array, float]:
    """Return the best similarity (3, 4), and the median residual (m); bad fixes are left out."""
    good = np.ones(len(stated), bool)
    for _ in range(4):
        fitted = fit_similarity(stated[good], measured[good])
        off = np.linalg.norm(stated @ fitted[:, :3].T + fitted[:, 3] - measured, axis=1)
        limit = 3 * SIGMA_OF_MEDIAN * float(np.median(off))
        good = off <= max(limit, 1e-6)
        if good.sum() < FEWEST:
            break
    return fitted, float(np.median(off))


def _explain(compared: _Compared, residual: float, named: bool) -> Finding:
    """Return why positions do not follow GPS: shifted, shuffled, mirrored or inexact."""
    figures = {"residual_m": residual}
    stated, measured = compared.stated, compared.measured
    if len(stated) > 2 * max(SHIFTS) and not named:
        shifted = {k: _fit(*_shift_pairs(stated, measured, k))[1] for k in SHIFTS}
        k = min(shifted, key=lambda key: shifted[key])
        if shifted[k] < _SHRINKS * residual:
            when = "earlier" if k > 0 else "later"
            detail = (
                f"positions are those of photographs {abs(k)} {when}: so read they are "
                f"{shifted[k]:.1f} m from GPS, as stated {residual:.1f} m"
            )
            return wrong(FOLLOW, "positions-shifted", detail, **figures, photographs=float(-k))
    mirrored = _fit(stated * [1, 1, -1], measured)[1]
    if mirrored < _SHRINKS * residual:
        detail = f"the world is mirrored (left-handed): mirrored back it is {mirrored:.1f} m off"
        return wrong(FOLLOW, "world-mirrored", detail, **figures)
    if named:
        why = (
            f"poses agree with the photographs, but GPS is {residual:.1f} m (median) from them "
            "after the best motion and scale: it lags behind, or is too coarse to compare with"
        )
        return unknown(FOLLOW, why, **figures)
    if compared.absolute:
        distances = np.linalg.norm(stated[:, None, :2] - measured[None, :, :2], axis=-1)
        nearest, own = float(np.median(distances.min(1))), float(np.median(np.diag(distances)))
        if nearest < _SHRINKS * own:
            detail = (
                f"names are shuffled: every position is {nearest:.1f} m from the GPS of some "
                f"photograph, but {own:.1f} m from that of its own"
            )
            return wrong(FOLLOW, "names-shuffled", detail, **figures)
    detail = f"{residual:.1f} m (median) from GPS after the best motion and scale"
    return wrong(FOLLOW, "positions-off", detail, **figures)


def _shift_pairs(stated: Array, measured: Array, k: int) -> tuple[Array, Array]:
    """Return both without the ends, with the stated positions of photographs ``k`` later."""
    return (stated[k:], measured[:-k]) if k > 0 else (stated[:k], measured[-k:])


def _offsets(compared: _Compared) -> Iterator[Finding]:
    off = compared.stated - compared.measured
    middle = np.median(off, 0)
    scatter = SIGMA_OF_MEDIAN * np.median(np.abs(off - middle), 0)
    away = float(np.linalg.norm(middle[:2]))
    spread = float(np.linalg.norm(scatter[:2]))
    limit = max(_OFFSET_M, 3 * spread / np.sqrt(len(off)))
    figures = {"east_m": float(middle[0]), "north_m": float(middle[1]), "scatter_m": spread}
    where = f"{middle[0]:+.1f} m east and {middle[1]:+.1f} m north of GPS"
    if away > limit:
        detail = f"all are {where}, scattered by {spread:.1f} m: another datum, or another origin"
        yield wrong(EAST_NORTH, "positions-offset", detail, **figures)
    else:
        yield right(EAST_NORTH, f"{where} (median)", **figures)
    up, rough, heights = _up(off, compared.high)
    if away > _ELSEWHERE_M:
        yield unknown(HEIGHTS, f"the photographs' GPS is {away / 1000:.4g} km away")
        return
    if heights < FEWEST:
        why = f"{heights} photographs have an altitude (GPSAltitude), {FEWEST} are needed"
        yield unknown(HEIGHTS, why)
        return
    if abs(up) <= max(_OFFSET_M, 3 * rough / np.sqrt(heights)):
        yield right(HEIGHTS, f"{_height(up)} them (median)", up_m=up, scatter_m=rough)
    elif rough > max(_SCATTER_M, abs(up) / 3):
        why = f"the photographs' altitudes scatter by {rough:.1f} m, {_height(-up)} the heights"
        yield unknown(HEIGHTS, why, up_m=up, scatter_m=rough)
    else:
        detail = (
            f"all are {_height(up)} those of the photographs, scattered by {rough:.1f} m: another "
            "height system, such as sea level instead of the ellipsoid (-106 to 85 m), or the "
            "take-off"
        )
        yield wrong(HEIGHTS, "height-datum", detail, up_m=up, scatter_m=rough)


def _up(off: Array, high: NDArray[np.bool_]) -> tuple[float, float, int]:
    """Return by how much stated heights are above measured ones, their scatter and their number."""
    if not high.any():
        return 0.0, 0.0, 0
    up = off[high, 2]
    middle = float(np.median(up))
    return middle, SIGMA_OF_MEDIAN * float(np.median(np.abs(up - middle))), len(up)


def _height(up: float) -> str:
    return f"{abs(up):.1f} m {'above' if up >= 0 else 'below'}"
