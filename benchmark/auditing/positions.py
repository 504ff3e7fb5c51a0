"""Check of stated positions against the GPS positions in the photographs' EXIF.

All positions are compared after a similarity alignment, whose scale shows whether the world is in
metres. Positions on earth are also compared without it, which shows constant offsets.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.auditing.findings import Finding, right, unknown, wrong
from benchmark.auditing.photograph_order import SHIFTS
from benchmark.auditing.statements import StatedData
from objconnect.ingestion.georegister import fit_similarity
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic, is_on_earth, median_place
from objconnect.scene.geometry.robust import SIGMA_OF_MEDIAN
from objconnect.scene.storage.exif import Exif

Array = NDArray[np.float64]

LATLON = "latitudes and longitudes are those of the photographs"
ALIGNED = "positions agree with the photographs' GPS after alignment"
SCALE = "the world is in metres"
EAST_NORTH = "positions have no horizontal offset from the photographs' GPS"
HEIGHTS = "heights are those of the photographs"

MIN_POSITIONS = 3
# Positions agree with GPS if the residual after a similarity alignment is below this share of the
# flight's extent.
_MAX_RESIDUAL_SHARE = 0.3
# A mistake is found if the residual shrinks to this share once it is corrected.
_CORRECTED_SHARE = 0.2
# A world is metric if the logarithm of its scale is below this; errors of GPS positions and of
# their times change the scale by a few per cent.
_MAX_LOG_SCALE = 0.05
# Relative uncertainty of the scale above which the scale is unknown.
_MAX_SCALE_UNCERTAINTY = 0.1
# Smallest constant offset (m) that is not an error of the receiver.
_MIN_OFFSET_M = 6.0
# Largest scatter (m) of the photographs' altitudes that still allows a comparison.
_MAX_SCATTER_M = 8.0
_FEET = 0.3048
# Only positions farther than this (m) from GPS are checked for mistakes in the coordinates.
_MIN_MISTAKE_M = 1000.0
# Positions farther than this (m) from GPS belong to another site. Heights are then not compared,
# because the earth curves in between.
_OTHER_SITE_M = 20_000.0


@dataclass(frozen=True)
class _LatlonFault:
    """A frequent mistake in latitudes and longitudes.

    Attributes:
        fault: its short name in the finding.
        description: its description in the finding.
        correct: undoes it in rows of latitude, longitude and height, (N, 3).
    """

    fault: str
    description: str
    correct: Callable[[Array], Array]


_LATLON_FAULTS = (
    _LatlonFault("latlon-swapped", "latitude and longitude are swapped", lambda p: p[:, [1, 0, 2]]),
    _LatlonFault(
        "latlon-radians",
        "latitude and longitude are radians where degrees are expected",
        lambda p: np.column_stack([np.degrees(p[:, :2]), p[:, 2]]),
    ),
    _LatlonFault("longitude-sign", "the sign of the longitude is lost", lambda p: p * [1, -1, 1]),
    _LatlonFault("latitude-sign", "the sign of the latitude is lost", lambda p: p * [-1, 1, 1]),
)


@dataclass(frozen=True)
class _PositionPairs:
    """Stated and measured positions of the n photographs that have both, metres.

    Attributes:
        stated: (n, 3).
        measured: (n, 3) east, north, up.
        absolute: whether both are in the same frame; else ``stated`` is in another world.
        has_height: whether each height in ``measured`` was measured, (n,); else it is the stated
            one.
    """

    stated: Array
    measured: Array
    absolute: bool
    has_height: NDArray[np.bool_]

    @property
    def extent(self) -> float:
        """Root mean square horizontal distance of the measured positions from their middle."""
        offsets = self.measured[:, :2] - self.measured[:, :2].mean(0)
        return float(np.sqrt((offsets**2).sum(1).mean()))


def check_positions(
    stated: StatedData, positions: Array | None, exif: Sequence[Exif | None], names_confirmed: bool
) -> tuple[list[Finding], Array]:
    """Check positions against the photographs' GPS.

    Returns:
        The findings, and east and north (m) of the photographs as stated and as measured, (n, 4).

    Args:
        stated: the data set.
        positions: camera centres (N, 3) in its world, in the right convention; None for a table of
            geodetic positions.
        exif: metadata of each photograph; None if it cannot be read.
        names_confirmed: whether the matches already showed that names and poses belong together;
            delayed GPS positions are then not reported as wrong names.
    """
    findings: list[Finding] = []
    measured = [None if e is None else e.position for e in exif]
    has_gps = np.array([fix is not None for fix in measured])
    has_height = np.array([fix is not None and not np.isnan(fix.altitude) for fix in measured])
    if stated.geodetic is None:
        has_gps = has_height  # poses in an arbitrary world are compared in three dimensions
    if has_gps.sum() >= MIN_POSITIONS:
        stated_geodetic = stated.geodetic
        fixes = _fill_heights(measured, has_gps, stated_geodetic)
        if stated_geodetic is not None:
            finding, stated_geodetic = _check_latlon(stated_geodetic[has_gps], fixes)
            findings.append(finding)
        centres_with_gps = None if positions is None else positions[has_gps]
        pairs = _pair_positions(fixes, stated_geodetic, centres_with_gps, has_height[has_gps])
    elif positions is not None and stated.measured is not None:
        has_gps = np.isfinite(stated.measured).all(1)
        all_true = np.ones(int(has_gps.sum()), bool)
        pairs = _PositionPairs(positions[has_gps], stated.measured[has_gps], True, all_true)
    else:
        pairs = None
    if pairs is None or len(pairs.measured) < MIN_POSITIONS:
        return [*findings, _report_missing_gps(stated, int(has_gps.sum()))], np.zeros((0, 4))
    findings += _compare(pairs, names_confirmed, positions is not None)
    return findings, _stated_and_measured_xy(pairs)


def _fill_heights(
    measured: Sequence[Geodetic | None], has_gps: NDArray[np.bool_], stated_geodetic: Array | None
) -> list[Geodetic]:
    """Return the measured positions of the photographs in ``has_gps``, each with a height.

    Positions without an altitude get the stated heights, shifted by the median difference of
    measured and stated heights, so that another height system causes no step between the two.
    """
    fixes = [(row, fix) for row, fix in enumerate(measured) if fix is not None and has_gps[row]]
    if stated_geodetic is None:
        return [fix for _, fix in fixes]
    stated_height = stated_geodetic[:, 2].tolist()
    differences = [fix.altitude - stated_height[row] for row, fix in fixes]
    known_differences = [each for each in differences if not np.isnan(each)]
    shift = float(np.median(known_differences)) if known_differences else 0.0
    return [
        fix._replace(altitude=stated_height[row] + shift) if np.isnan(fix.altitude) else fix
        for row, fix in fixes
    ]


def _stated_and_measured_xy(pairs: _PositionPairs) -> Array:
    """Return east and north (m) as stated and as measured, (n, 4), for the drawing.

    Stated positions of another world are aligned to the measured ones.
    """
    stated = pairs.stated
    if not pairs.absolute:
        fitted, _ = _fit(stated, pairs.measured)
        stated = stated @ fitted[:, :3].T + fitted[:, 3]
    return np.column_stack([stated[:, :2], pairs.measured[:, :2]])


def _report_missing_gps(stated: StatedData, count: int) -> Finding:
    """Return the finding if too few photographs have GPS.

    Stated coordinates that are not on earth are reported as wrong even then.
    """
    if stated.geodetic is not None:
        is_off_earth = [not is_on_earth(Geodetic(*row)) for row in stated.geodetic.tolist()]
        if any(is_off_earth):
            first = is_off_earth.index(True)
            name, row = stated.names[first], stated.geodetic[first]
            swapped = is_on_earth(Geodetic(float(row[1]), float(row[0]), float(row[2])))
            fault, description = (
                ("latlon-swapped", "latitude and longitude are swapped")
                if swapped
                else ("not-on-earth", "they are not degrees")
            )
            detail = f"{name} is at {row[0]:g}, {row[1]:g}, which is not on earth: {description}"
            return wrong(LATLON, fault, detail)
    what = "a GPS position" if stated.geodetic is not None else "a GPS position with its altitude"
    return unknown(ALIGNED, f"{count} photographs have {what}, {MIN_POSITIONS} are needed")


def _check_latlon(stated_geodetic: Array, fixes: Sequence[Geodetic]) -> tuple[Finding, Array]:
    """Check stated latitudes and longitudes (n, 3) against GPS, and return them corrected."""
    origin = median_place(fixes)
    measured = np.array([enu_from_geodetic(fix, origin) for fix in fixes])

    def distance(geodetic: Array) -> float:
        enu = np.array([enu_from_geodetic(Geodetic(*row), origin) for row in geodetic.tolist()])
        return float(np.median(np.linalg.norm((enu - measured)[:, :2], axis=1)))

    as_stated = distance(stated_geodetic)
    best, mistake = min(
        ((distance(each.correct(stated_geodetic)), each) for each in _LATLON_FAULTS),
        key=lambda item: item[0],
    )
    if best < _CORRECTED_SHARE * as_stated and as_stated > _MIN_MISTAKE_M:
        detail = (
            f"{mistake.description}: corrected they are {best:.0f} m from GPS, as stated "
            f"{as_stated:.4g} m"
        )
        finding = wrong(LATLON, mistake.fault, detail, metres=as_stated, explained_metres=best)
        return finding, mistake.correct(stated_geodetic)
    if as_stated > _OTHER_SITE_M:
        why = f"they are {as_stated / 1000:.4g} km from GPS, and no swap, sign or unit explains it"
        return unknown(LATLON, why, metres=as_stated), stated_geodetic
    return right(LATLON, f"median {as_stated:.1f} m from GPS", metres=as_stated), stated_geodetic


def _pair_positions(
    fixes: Sequence[Geodetic],
    geodetic: Array | None,
    positions: Array | None,
    has_height: NDArray[np.bool_],
) -> _PositionPairs:
    """Pair GPS fixes with stated geodetic positions or, without these, with camera centres."""
    origin = median_place(fixes)
    measured = np.array([enu_from_geodetic(fix, origin) for fix in fixes])
    if geodetic is not None:
        rows = [enu_from_geodetic(Geodetic(*row), origin) for row in geodetic.tolist()]
        return _PositionPairs(np.array(rows), measured, True, has_height)
    assert positions is not None
    return _PositionPairs(positions, measured, False, has_height)


def _compare(pairs: _PositionPairs, names_confirmed: bool, has_poses: bool) -> Iterator[Finding]:
    """Yield the findings on the course, the scale and the offsets of stated positions."""
    extent = pairs.extent
    if extent < 1.0:
        yield unknown(ALIGNED, f"the photographs were taken within {extent:.1f} m")
        return
    fitted, residual = _fit(pairs.stated, pairs.measured)
    scale = float(np.cbrt(max(np.linalg.det(fitted[:, :3]), 0.0)))
    if residual > _MAX_RESIDUAL_SHARE * extent:
        yield _explain(pairs, residual, names_confirmed)
        return
    yield right(
        ALIGNED,
        f"{residual:.2f} m (median) from GPS after similarity alignment, over {extent:.0f} m",
        residual_m=residual,
    )
    uncertainty = 3 * residual / (extent * np.sqrt(len(pairs.stated)))
    if abs(np.log(max(scale, 1e-9))) > max(_MAX_LOG_SCALE, uncertainty):
        unit = "feet" if abs(scale / _FEET - 1) < _MAX_LOG_SCALE else "an unknown unit"
        detail = f"one unit is {scale:.4g} m: the world is in {unit}"
        yield wrong(SCALE, "scale", detail, scale=scale)
    elif uncertainty > _MAX_SCALE_UNCERTAINTY:
        yield unknown(SCALE, f"GPS determines the scale to {uncertainty:.0%} only", scale=scale)
    else:
        yield right(SCALE, f"one unit is {scale:.3f} m by GPS", scale=scale)
    if pairs.absolute:
        yield from _check_offsets(pairs)
    elif has_poses:
        yield unknown(HEIGHTS, "the data set does not state where its world is on earth")


def _fit(stated: Array, measured: Array) -> tuple[Array, float]:
    """Return the best similarity (3, 4), and the median residual (m); bad fixes are left out."""
    good = np.ones(len(stated), bool)
    for _ in range(4):
        fitted = fit_similarity(stated[good], measured[good])
        residuals = np.linalg.norm(stated @ fitted[:, :3].T + fitted[:, 3] - measured, axis=1)
        limit = 3 * SIGMA_OF_MEDIAN * float(np.median(residuals))
        good = residuals <= max(limit, 1e-6)
        if good.sum() < MIN_POSITIONS:
            break
    return fitted, float(np.median(residuals))


def _explain(pairs: _PositionPairs, residual: float, names_confirmed: bool) -> Finding:
    """Return why positions do not agree with GPS: shifted, shuffled, mirrored or inexact."""
    figures = {"residual_m": residual}
    stated, measured = pairs.stated, pairs.measured
    if len(stated) > 2 * max(SHIFTS) and not names_confirmed:
        shifted = {k: _fit(*_shift_pairs(stated, measured, k))[1] for k in SHIFTS}
        k = min(shifted, key=lambda key: shifted[key])
        if shifted[k] < _CORRECTED_SHARE * residual:
            when = "earlier" if k > 0 else "later"
            detail = (
                f"positions belong to the photographs {abs(k)} {when}: with this shift they are "
                f"{shifted[k]:.1f} m from GPS, as stated {residual:.1f} m"
            )
            return wrong(ALIGNED, "positions-shifted", detail, **figures, photographs=float(-k))
    mirrored = _fit(stated * [1, 1, -1], measured)[1]
    if mirrored < _CORRECTED_SHARE * residual:
        detail = f"the world is mirrored (left-handed): mirrored back it is {mirrored:.1f} m off"
        return wrong(ALIGNED, "world-mirrored", detail, **figures)
    if names_confirmed:
        why = (
            f"poses agree with the photographs, but GPS is {residual:.1f} m (median) from them "
            "after similarity alignment: it lags behind, or is too coarse to compare with"
        )
        return unknown(ALIGNED, why, **figures)
    if pairs.absolute:
        distances = np.linalg.norm(stated[:, None, :2] - measured[None, :, :2], axis=-1)
        to_nearest = float(np.median(distances.min(1)))
        to_same_name = float(np.median(np.diag(distances)))
        if to_nearest < _CORRECTED_SHARE * to_same_name:
            detail = (
                f"names are shuffled: positions are {to_nearest:.1f} m (median) from the nearest "
                f"GPS position, but {to_same_name:.1f} m from that of the same name"
            )
            return wrong(ALIGNED, "names-shuffled", detail, **figures)
    detail = f"{residual:.1f} m (median) from GPS after similarity alignment"
    return wrong(ALIGNED, "positions-off", detail, **figures)


def _shift_pairs(stated: Array, measured: Array, k: int) -> tuple[Array, Array]:
    """Return pairs of each measured position and the stated position ``k`` photographs later."""
    return (stated[k:], measured[:-k]) if k > 0 else (stated[:k], measured[-k:])


def _check_offsets(pairs: _PositionPairs) -> Iterator[Finding]:
    """Yield the findings on constant offsets from GPS: horizontal, then of heights."""
    differences = pairs.stated - pairs.measured
    middle = np.median(differences, 0)
    scatter = SIGMA_OF_MEDIAN * np.median(np.abs(differences - middle), 0)
    distance_m = float(np.linalg.norm(middle[:2]))
    spread = float(np.linalg.norm(scatter[:2]))
    limit = max(_MIN_OFFSET_M, 3 * spread / np.sqrt(len(differences)))
    figures = {"east_m": float(middle[0]), "north_m": float(middle[1]), "scatter_m": spread}
    where = f"{middle[0]:+.1f} m east and {middle[1]:+.1f} m north of GPS"
    if distance_m > limit:
        detail = f"all are {where}, scattered by {spread:.1f} m: another datum, or another origin"
        yield wrong(EAST_NORTH, "positions-offset", detail, **figures)
    else:
        yield right(EAST_NORTH, f"{where} (median)", **figures)
    up, scatter_up, heights = _height_offset(differences, pairs.has_height)
    if distance_m > _OTHER_SITE_M:
        yield unknown(HEIGHTS, f"the photographs' GPS is {distance_m / 1000:.4g} km away")
        return
    if heights < MIN_POSITIONS:
        why = f"{heights} photographs have an altitude (GPSAltitude), {MIN_POSITIONS} are needed"
        yield unknown(HEIGHTS, why)
        return
    if abs(up) <= max(_MIN_OFFSET_M, 3 * scatter_up / np.sqrt(heights)):
        yield right(HEIGHTS, f"{_above_or_below(up)} them (median)", up_m=up, scatter_m=scatter_up)
    elif scatter_up > max(_MAX_SCATTER_M, abs(up) / 3):
        why = (
            f"the photographs' altitudes scatter by {scatter_up:.1f} m and are "
            f"{_above_or_below(-up)} the stated heights (median)"
        )
        yield unknown(HEIGHTS, why, up_m=up, scatter_m=scatter_up)
    else:
        detail = (
            f"all are {_above_or_below(up)} those of the photographs, scattered by "
            f"{scatter_up:.1f} m: another height system, such as above sea level instead of the "
            "ellipsoid (they differ by -106 to 85 m), or above the take-off"
        )
        yield wrong(HEIGHTS, "height-datum", detail, up_m=up, scatter_m=scatter_up)


def _height_offset(differences: Array, has_height: NDArray[np.bool_]) -> tuple[float, float, int]:
    """Return the median of stated minus measured heights, their scatter and their number."""
    if not has_height.any():
        return 0.0, 0.0, 0
    up = differences[has_height, 2]
    middle = float(np.median(up))
    return middle, SIGMA_OF_MEDIAN * float(np.median(np.abs(up - middle))), len(up)


def _above_or_below(up: float) -> str:
    return f"{abs(up):.1f} m {'above' if up >= 0 else 'below'}"
