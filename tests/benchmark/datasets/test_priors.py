"""Tables of priors: positions of either frame, with or without heights, sigmas and attitudes."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np
import pytest

from benchmark.datasets.flight import gps_sigma, open_flight
from objconnect.scene.errors import InputError
from objconnect.scene.flights.priors import AssumedSigmas, MapFrame
from objconnect.scene.flights.textfiles import read_priors
from objconnect.scene.geometry.geodesy import Geodetic, geodetic_from_enu
from objconnect.scene.localizer import Prior
from objconnect.scene.maps.colmap_files import read_model

ORIGIN = Geodetic(47.0, 8.0, 450.0)
MIDDLE = np.array([3.0, -2.0, 41.0])
FRAME = MapFrame(ORIGIN, MIDDLE)
TOLD = AssumedSigmas(np.full(3, 12.0), 6.0, "the option stands for it", "that one stands for it")


def read(
    folder: Path, *lines: str, frame: MapFrame = FRAME, assumed: AssumedSigmas = TOLD
) -> dict[str, Prior]:
    path = folder / "priors.csv"
    path.write_text("\n".join(lines) + "\n")
    table = read_priors(path)
    return table.priors(frame, table.rows, assumed)


def sigma_of(prior: Prior) -> list[float]:
    assert prior.position_sigma is not None
    sigma: list[float] = prior.position_sigma.tolist()
    return sigma


def test_a_table_may_state_metres(tmp_path: Path) -> None:
    prior = read(tmp_path, "name,e,n,u", "a.jpg,1,2,30")["a.jpg"]
    assert prior.position.tolist() == [1, 2, 30]
    assert sigma_of(prior) == [12, 12, 12]
    assert prior.cam_from_world_rotation is None
    assert prior.attitude_sigma_deg is None


def test_a_table_may_state_latitude_and_longitude(tmp_path: Path) -> None:
    lat, lon, alt = geodetic_from_enu(np.array([15.0, -7.0, 38.0]), ORIGIN)
    row = f"a.jpg,{alt!r},{lon!r},{lat!r},4"
    prior = read(tmp_path, "name,alt,lon,lat,sigma_m", row)["a.jpg"]
    assert prior.position == pytest.approx([15, -7, 38], abs=1e-4)
    assert sigma_of(prior) == [4, 4, 4]


@pytest.mark.parametrize("header", ["name,lat,lon", "name,lat,lon,alt", "name,e,n", "name,e,n,u"])
def test_an_unknown_height_is_unknown(
    tmp_path: Path, header: str, caplog: pytest.LogCaptureFixture
) -> None:
    place = geodetic_from_enu(np.array([15.0, -7.0, 0.0]), ORIGIN)
    numbers = f"{place[0]!r},{place[1]!r}" if "lat" in header else "15,-7"
    empty = "," * (header.count(",") - 2)
    with caplog.at_level(logging.WARNING):
        prior = read(tmp_path, header, f"a.jpg,{numbers}{empty}")["a.jpg"]
    assert prior.position == pytest.approx([15, -7, MIDDLE[2]], abs=1e-3)
    assert sigma_of(prior) == [12, 12, np.inf]
    assert any("1 of 1 rows state no heights" in record.message for record in caplog.records)


def test_a_sigma_that_is_missing_is_that_of_the_option(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        priors = read(tmp_path, "name,e,n,u,sigma_m", "a.jpg,1,2,30,", "b.jpg,1,2,30,5")
    assert sigma_of(priors["a.jpg"]) == [12, 12, 12]
    assert sigma_of(priors["b.jpg"]) == [5, 5, 5]
    (record,) = caplog.records
    assert "1 of 2 rows state no sigma_m: the option stands for it" in record.message


def test_an_attitude_without_a_sigma_has_that_of_the_option(tmp_path: Path) -> None:
    header = "name,e,n,u,sigma_m,qw,qx,qy,qz"
    priors = read(tmp_path, header, "a.jpg,1,2,30,3,0,1,0,0", "b.jpg,1,2,30,3,,,,")
    assert priors["a.jpg"].attitude_sigma_deg == 6
    assert priors["a.jpg"].cam_from_world_rotation == pytest.approx(np.diag([1.0, -1, -1]))
    assert priors["b.jpg"].cam_from_world_rotation is None


@pytest.mark.parametrize(
    ("header", "row", "said"),
    [
        ("name,lat,lon,alt_ft", "a.jpg,47,8,1000", "'alt_ft'"),
        ("name,x,y", "a.jpg,1,2", "'x'"),
        ("name,lon,lat,comment", "a.jpg,8,47,fine", "'comment'"),
        ("name,e,n,u,sigma", "a.jpg,1,2,3,4", "'sigma'"),
        ("name,lat,lon", "a.jpg,8.0,47.0", "exchanged"),
        ("name,lat,lon", "a.jpg,0,0", "off the map"),
        ("name,lat,lon", "a.jpg,470000000,80000000", "lat, lon are not a place on earth"),
        ("name,lat,lon", "a.jpg,0.8203,0.1396", "off the map"),
        ("name,lat,lon", "a.jpg,47°00'00\",8°0'0\"", "is not a number"),
        ("name,lat,lon", "a.jpg,,8", "is not a number"),
        ("name,lat,lon", "a.jpg,nan,8", "not a finite number"),
        ("name,e,n,u", "a.jpg,465000,5205000,480", "not eastings and northings"),
        ("name,e,n,u", "a.jpg,1,2,inf", "not a finite number"),
        ("name,e,n,u,sigma_m", "a.jpg,1,2,3,0", "sigma_m must be positive"),
        ("name,e,n,u,sigma_m", "a.jpg,1,2,3,-4", "sigma_m must be positive"),
        ("name,e,n,u,qw,qx", "a.jpg,1,2,3,1,0", "qy, qz"),
        ("name,e,n,u,sigma_deg", "a.jpg,1,2,3,1", "sigma_deg"),
        ("name,e,n,u,qw,qx,qy,qz", "a.jpg,1,2,3,1,,,", "is not a number"),
        ("name,e,n,u,", "a.jpg,1,2,3,4", "has no name"),
        ("name;e;n;u", "a.jpg;1;2;3", "use commas"),
        ("e,n,u", "1,2,3", "lacks the column name"),
    ],
)
def test_errors_name_what_is_missing(tmp_path: Path, header: str, row: str, said: str) -> None:
    with pytest.raises(InputError) as error:
        read(tmp_path, header, row)
    assert said in str(error.value)
    assert "priors.csv:" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_header_without_rows_is_checked(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'alt_ft'"):
        read(tmp_path, "name,lat,lon,alt_ft")


def test_a_far_position_with_a_large_sigma_is_accepted(tmp_path: Path) -> None:
    prior = read(tmp_path, "name,e,n,u,sigma_m", "a.jpg,90000,0,40,50000")["a.jpg"]
    assert prior.position.tolist() == [90000, 0, 40]


def test_places_on_earth_need_a_map_on_earth(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"the map has no position on earth: write e, n, u"):
        read(tmp_path, "name,lat,lon", "a.jpg,47,8", frame=MapFrame(None, MIDDLE))
    read(tmp_path, "name,e,n", "a.jpg,1,2", frame=MapFrame(None, MIDDLE))


def test_positions_of_other_photographs_are_not_checked(tmp_path: Path) -> None:
    path = tmp_path / "priors.csv"
    path.write_text("name,e,n,u\na.jpg,1,2,3\nelsewhere.jpg,465000,5205000,480\n")
    assert list(read_priors(path).priors(FRAME, ["a.jpg"], TOLD)) == ["a.jpg"]


def _random_table(random: Random) -> tuple[str, str, np.ndarray]:
    """A table of one row in a random frame and order, and the true position."""
    truth = np.array([random.uniform(-400, 400), random.uniform(-400, 400), random.uniform(0, 150)])
    lat, lon, alt = geodetic_from_enu(truth, ORIGIN)
    if random.random() < 0.5:
        cells = {"e": truth[0], "n": truth[1], "u": truth[2]}
    else:
        names = random.choice([("lat", "lon", "alt"), ("latitude", "longitude", "altitude_m")])
        cells = dict(zip(names, (lat, lon, alt), strict=True))
    spoiled = random.choice([*[None] * 4, "exchange", "feet", "radians", "unnamed", "drop"])
    names = list(cells)
    if spoiled == "exchange" and "e" not in cells:
        cells[names[0]], cells[names[1]] = cells[names[1]], cells[names[0]]
    elif spoiled == "feet":
        cells[f"{names[2]}_ft"] = cells.pop(names[2]) / 0.3048
    elif spoiled == "radians" and "e" not in cells:
        cells |= {name: np.radians(cells[name]) for name in names[:2]}
    elif spoiled == "unnamed":
        cells["z"] = cells.pop(names[2])
    elif spoiled == "drop":
        del cells[random.choice(names)]
    columns: dict[str, object] = {"name": "a.jpg", **{k: repr(float(v)) for k, v in cells.items()}}
    if random.random() < 0.5:
        columns["sigma_m"] = random.choice(["", "3.5"])
    order = random.sample(sorted(columns), len(columns))
    return ",".join(order), ",".join(str(columns[name]) for name in order), truth


def test_a_prior_is_exact_or_unknown_or_an_error(tmp_path: Path) -> None:
    """Never another value, whatever frame, order and unit a table has."""
    random, found, refused = Random(11), 0, 0
    logging.disable(logging.WARNING)
    try:
        for _ in range(2000):
            header, row, truth = _random_table(random)
            try:
                prior = read(tmp_path, header, row)["a.jpg"]
            except InputError as error:
                assert "priors.csv:" in str(error)
                refused += 1
                continue
            assert prior.position[:2] == pytest.approx(truth[:2], abs=0.02), (header, row)
            if np.isfinite(sigma_of(prior)[2]):
                assert prior.position[2] == pytest.approx(truth[2], abs=0.02), (header, row)
            found += 1
    finally:
        logging.disable(logging.NOTSET)
    assert found > 800
    assert refused > 300


@pytest.fixture
def priors_of(made_flight: Path) -> Callable[..., list[Prior | None]]:
    """Write the priors of a flight and open it."""

    def open_priors(*lines: str) -> list[Prior | None]:
        (made_flight / "priors.csv").write_text("\n".join(lines) + "\n")
        return [query.prior for query in open_flight(made_flight)[0].queries]

    return open_priors


def test_a_flight_measures_the_sigma_on_its_map(
    made_flight: Path, priors_of: Callable[..., list[Prior | None]]
) -> None:
    sparse_map = read_model(made_flight / "sparse" / "map")
    off = np.array([3.0, -4.0, 1.0])
    fixes = {name: image.centre + off for name, image in sparse_map.images.items()}
    rows = [",".join([name, *map(str, fix.tolist())]) for name, fix in fixes.items()]
    first, second, _ = priors_of("name,e,n,u", *rows, "b.jpg,1,2,3")
    assert first is not None
    assert first.position_sigma == pytest.approx([3, 4, 1])
    assert first.position_sigma == pytest.approx(gps_sigma(fixes, sparse_map))
    assert second is None


def test_a_flight_without_gps_on_its_map_has_no_sigma(
    priors_of: Callable[..., list[Prior | None]],
) -> None:
    with pytest.raises(InputError, match=r"priors\.csv:2: .*add a value sigma_m"):
        priors_of("name,e,n,u", "b.jpg,1,2,3")
    with pytest.raises(InputError, match=r"priors\.csv:2: .*add a value sigma_deg"):
        priors_of("name,e,n,u,sigma_m,qw,qx,qy,qz", "b.jpg,1,2,3,4,0,1,0,0")


def test_a_flight_with_an_origin_takes_geodetic_priors(
    made_flight: Path, priors_of: Callable[..., list[Prior | None]]
) -> None:
    lat, lon, _ = geodetic_from_enu(np.array([2.0, 1.0, 0.0]), ORIGIN)
    lines = ("name,lat,lon,sigma_m", f"b.jpg,{lat!r},{lon!r},8")
    with pytest.raises(InputError, match="no position on earth"):
        priors_of(*lines)
    (made_flight / "origin.json").write_text('{"lat": 47.0, "lon": 8.0, "alt": 450.0}')
    prior = priors_of(*lines)[0]
    assert prior is not None
    assert prior.position == pytest.approx([2, 1, 40], abs=1e-3)
    assert sigma_of(prior) == [8, 8, np.inf]
