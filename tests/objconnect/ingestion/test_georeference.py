"""How exactly ingest says that a scene lies on earth."""

from __future__ import annotations

import numpy as np
import pytest

from objconnect.ingestion.control import ControlResidual, Role
from objconnect.ingestion.georeference import GpsFixes, estimate_georeference
from objconnect.ingestion.georegister import Georegistration
from objconnect.ingestion.options import IngestOptions
from objconnect.scene.bundle.georeference import Georeference
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.sparse_map import MapImage, SparseMap

NAMES = [f"{k}.jpg" for k in range(9)]
FIXES = {name: np.array([10.0 * k, 0.0, 40.0]) for k, name in enumerate(NAMES)}
CAMERA = Camera("SIMPLE_PINHOLE", 64, 48, (50.0, 32.0, 24.0))
OPTIONS = IngestOptions(
    control_sigma_m=0.04, receiver_sigma_m=3, receiver_height_sigma_m=6, height_datum_sigma_m=30
)


def model() -> SparseMap:
    none = np.zeros((0, 2)), np.zeros(0, np.int64)
    images = {name: MapImage(name, CAMERA, np.eye(4), *none) for name in NAMES}
    points = np.zeros((0, 3))
    return SparseMap(images, points, points.astype(np.uint8), points[:, 0], none[1])


def measure(
    sigma: tuple[float, float, float],
    *control: ControlResidual,
    fixes: int = 9,
    blunders: tuple[str, ...] = (),
    stated: dict[str, tuple[float, float, float]] | None = None,
) -> Georeference | None:
    placed = Georegistration(np.eye(4)[:3], "gps", blunders, np.array(sigma))
    gps = GpsFixes({name: FIXES[name] for name in NAMES[:fixes]}, stated or {})
    return estimate_georeference(model(), placed, gps, control, OPTIONS)


def point(role: Role, *off: float) -> ControlResidual:
    east, north, up = off
    return ControlResidual(name="P", role=role, marks=4, off=(east, north, up))


def test_what_a_flight_shares_and_the_scatter_of_its_fixes_add_up() -> None:
    # East 3 and 4, north 3 and 0: the root of 25 + 9. Up 6 and 30 and 2.
    found = measure((4.0, 0.0, 2.0))
    assert found == Georeference(horizontal_m=5.831, vertical_m=30.6594, source="gps")


def test_more_fixes_of_one_flight_do_not_make_it_more_exact() -> None:
    assert measure((4.0, 0.0, 2.0), fixes=4) == measure((4.0, 0.0, 2.0), fixes=9)


def test_late_fixes_are_as_wrong_as_they_scatter() -> None:
    found = measure((8.0, 9.0, 1.0))
    assert found is not None and found.horizontal_m > np.hypot(8, 9)


def test_rtk_states_its_own_sigma_and_has_heights_above_the_ellipsoid() -> None:
    stated = dict.fromkeys(NAMES, (0.01, 0.02, 0.03))
    found = measure((0.02, 0.02, 0.04), stated=stated)
    assert found == Georeference(
        horizontal_m=round(np.sqrt(0.01**2 + 3 * 0.02**2), 4), vertical_m=0.05, source="gps"
    )


def test_one_fix_without_correction_leaves_that_of_the_receiver() -> None:
    stated = dict.fromkeys(NAMES[1:], (0.01, 0.02, 0.03))
    found = measure((0.02, 0.02, 0.04), stated=stated)
    assert found is not None and found.horizontal_m == pytest.approx(4.24, abs=0.01)
    # Unless it contradicts the others and is not used.
    without = measure((0.02, 0.02, 0.04), stated=stated, blunders=(NAMES[0],))
    assert without is not None and without.horizontal_m < 0.05


def test_without_fixes_it_is_unknown() -> None:
    assert measure((0.02, 0.02, 0.02), fixes=0) is None
    assert measure((0.02, 0.02, 0.02), fixes=2) is None
    assert measure((0.02, 0.02, 0.02), fixes=3, blunders=(NAMES[0],)) is None


def test_unknown_heights_leave_the_height_unknown() -> None:
    found = measure((4.0, 0.0, float("nan")))
    assert found == Georeference(horizontal_m=5.831, vertical_m=None, source="gps")


def test_check_points_measure_it() -> None:
    checks = [point("check", 0.3, 0.0, 0.4), point("check", 0.0, -0.3, -0.4)]
    used = [point("used", 0.01, 0.01, 0.01)] * 3
    found = measure((4.0, 4.0, 4.0), *used, *checks, point("wrong", 50, 50, 50))
    east = 0.3**2 / 2 + 0.04**2
    assert found == Georeference(
        horizontal_m=round(np.sqrt(2 * east), 4),
        vertical_m=round(np.hypot(0.4, 0.04), 4),
        source="control",
    )


def test_used_points_tell_it_where_there_is_no_other() -> None:
    found = measure((4.0, 4.0, 4.0), *[point("used", 0.03, 0.0, 0.0)] * 3, fixes=0)
    assert found == Georeference(horizontal_m=0.064, vertical_m=0.04, source="control")


def test_one_or_two_points_that_shift_the_scene_tell_nothing() -> None:
    """Their residuals are none, for the shift has taken them."""
    found = measure((4.0, 0.0, 2.0), *[point("used", 0.0, 0.0, 0.0)] * 2)
    assert found is not None and found.source == "gps"
