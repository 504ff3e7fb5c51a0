"""Units, scales and undeclared holes of surface models."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest
import rasterio
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geo.rasters import Raster
from objconnect.scene.geometry.geodesy import Geodetic
from tests.objconnect.scene.geo.raster_files import values_of, write

RNG = np.random.default_rng(4)
HILLS = (180 + 20 * RNG.random((1, 60, 80))).astype(np.float32)
FOOT, US_FOOT = 0.3048, 1200 / 3937
PLACE = Geodetic(46.95, 9.0, 180.0)


def unit(name: str) -> Any:
    def say(file: Any) -> None:
        file.units = [name]

    return say


@pytest.mark.parametrize(
    ("name", "metres"),
    [
        ("foot", FOOT),
        ("US survey foot", US_FOOT),
        ("ft", FOOT),
        ("Feet", FOOT),
        ("ftUS", US_FOOT),
        ("metre", 1.0),
        ("Meters", 1.0),
        ("m", 1.0),
        ("cm", 0.01),
        ("yard", 0.9144),
        ("[m]", 1.0),
        ("dm", 0.1),
        ("mètre", 1.0),
    ],
)
def test_units(tmp_path: Path, name: str, metres: float) -> None:
    path = write(tmp_path / "d.tif", (HILLS / metres).astype(np.float32), after=unit(name))
    np.testing.assert_allclose(values_of(path, "surface model"), HILLS, atol=1e-3)


@pytest.mark.parametrize("name", ["fathom", "dB", "degrees", "m/s"])
def test_an_unknown_unit_is_named(tmp_path: Path, name: str) -> None:
    path = write(tmp_path / "d.tif", HILLS, after=unit(name))
    with pytest.raises(InputError, match=f"band's unit is unknown .*{name}.*gdal_edit .*-units"):
        Raster.open(path, "surface model")


@pytest.mark.parametrize(
    ("scale", "offset", "name"), [(0.01, 100.0, "m"), (0.1, 0.0, "foot"), (2.0, -50.0, "yard")]
)
def test_scale_and_offset(tmp_path: Path, scale: float, offset: float, name: str) -> None:
    metres = {"m": 1.0, "foot": FOOT, "yard": 0.9144}[name]
    stored = np.rint((HILLS / metres - offset) / scale).astype(np.int32)
    stored[0, 3, 4] = -1

    def say(file: Any) -> None:
        file.scales, file.offsets, file.units = [scale], [offset], [name]

    path = write(tmp_path / "d.tif", stored, nodata=-1, after=say)
    read = values_of(path, "surface model")
    assert np.isnan(read[0, 3, 4])  # no data is a number of the file, not a height
    read[0, 3, 4] = HILLS[0, 3, 4]
    np.testing.assert_allclose(read, HILLS, atol=scale * metres)


def test_a_scale_of_nothing_is_named(tmp_path: Path) -> None:
    def say(file: Any) -> None:
        file.scales = [0.0]

    with pytest.raises(InputError, match="the band's scale is 0"):
        Raster.open(write(tmp_path / "d.tif", HILLS, after=say), "surface model")


def test_what_is_not_stated_is_told(tmp_path: Path) -> None:
    silent = Raster.open(write(tmp_path / "a.tif", HILLS), "surface model")
    assert silent.notes(PLACE) == (
        "a.tif states neither unit nor reference of its heights: taken as metres above the "
        "ellipsoid",
    )
    assert silent.notes(PLACE, 48.0) == ("a.tif states no unit of its heights: taken as metres",)
    metres = Raster.open(write(tmp_path / "b.tif", HILLS, after=unit("metre")), "surface model")
    assert "no reference" in metres.notes(PLACE)[0] and not metres.notes(PLACE, 0.0)


# ---- No data that is not declared ----------------------------------------------------------------


def rim(values: NDArray[np.float32], height: float) -> NDArray[np.float32]:
    """The raster with a rim, a corner and a hole of one height."""
    values = values.copy()
    values[0, :9] = values[0, :, -5:] = values[0, 30:34, 20:27] = height
    return values


@pytest.mark.parametrize(
    "height", [-999.0, -9999.0, -32767.0, 0.0, -1.0, -100.0, 50.0, 3.4e38, 9999.0, 1e20]
)
@pytest.mark.parametrize("nodata", [None, -7777.0])
def test_holes_are_no_cliffs(tmp_path: Path, height: float, nodata: float | None) -> None:
    path = write(tmp_path / "d.tif", rim(HILLS, height), nodata=nodata)
    read = values_of(path, "surface model")
    assert np.array_equal(np.isnan(read), rim(HILLS, height) != HILLS)


@pytest.mark.parametrize("height", [-999.0, 0.0, -9999.0])
def test_resampled_holes_are_no_cliffs(tmp_path: Path, height: float) -> None:
    """A resampling program mixes no data with heights at its border."""
    values = rim(HILLS, height)
    values[0, 9] = 0.5 * (values[0, 9] + height)
    path = write(tmp_path / "d.tif", values)
    read = values_of(path, "surface model")
    assert np.nanmin(read) > 165


@pytest.mark.parametrize(
    ("dtype", "scale", "number"),
    [
        ("uint16", 0.1, 65535),  # 6553.5 m, which is on earth
        ("int16", 0.1, 32767),
        ("uint16", 1.0, 0),
        ("int16", 1.0, -1),
        ("uint16", 1.0, 5000),
    ],
)
def test_holes_of_whole_numbers_are_no_cliffs(
    tmp_path: Path, dtype: str, scale: float, number: int
) -> None:
    values = np.rint(HILLS / scale).astype(dtype)
    values[0, :10] = number

    def say(file: Any) -> None:
        file.scales = [scale]

    raster = Raster.open(write(tmp_path / "d.tif", values, after=say), "surface model")
    read = raster.patch(raster.grid.box).values
    assert np.isnan(read[0, :10]).all()
    np.testing.assert_allclose(read[0, 10:], HILLS[0, 10:], atol=0.6)
    assert "all others: treated as no data" in raster.doubts[0]


def test_zeros_above_low_ground(tmp_path: Path) -> None:
    """Far above they are no data; between heights they may be water, which is told."""
    deep, polder = HILLS - 600, HILLS - 190
    deep[0, :10] = polder[0, :10] = 0
    read = values_of(write(tmp_path / "d.tif", deep), "surface model")
    assert np.array_equal(np.isnan(read), deep == 0)
    raster = Raster.open(write(tmp_path / "e.tif", polder), "surface model")
    assert np.array_equal(raster.patch(raster.grid.box).values, polder)
    assert "have the height 0 m, between the others" in raster.doubts[0]
    steps = np.rint(10 * (HILLS - 190)) / 10
    stepped = write(tmp_path / "f.tif", steps.astype(np.float32))
    assert Raster.open(stepped, "surface model").doubts == ()


def test_a_lake_and_a_pit_stay(tmp_path: Path) -> None:
    lake = HILLS.copy()
    lake[0, :, 50:] = 179.9
    pit = HILLS.copy()
    pit[0, 20:40, 20:40] = 120 + RNG.random((20, 20))
    plain = np.full((1, 60, 80), 200, np.float32)
    plain[0, 20:30, 20:30] = 245.0
    for name, values in (("lake", lake), ("pit", pit), ("plain with a tower", plain)):
        path = write(tmp_path / f"{name}.tif", values.astype(np.float32))
        assert np.array_equal(values_of(path, "surface model"), values), name


def test_the_sea_stays_and_is_told(tmp_path: Path) -> None:
    quay = (3 + 4 * RNG.random((1, 60, 80))).astype(np.float32)
    quay[0, :, :30] = 0
    raster = Raster.open(write(tmp_path / "d.tif", quay), "surface model")
    assert np.array_equal(raster.patch(raster.grid.box).values, quay)
    assert "37.5 % of the pixels have the height 0 m" in raster.doubts[0]


def test_a_plain_or_no_data(tmp_path: Path) -> None:
    """Most of the raster has one height, and all that is not flat stands far above."""
    values = np.full((1, 60, 80), 150, np.float32)
    values[0, 20:30, 20:40] = HILLS[0, 20:30, 20:40]
    with pytest.raises(InputError, match="150 m, far below all others: no data or a plain"):
        Raster.open(write(tmp_path / "d.tif", values), "surface model")
    read = values_of(write(tmp_path / "e.tif", values, nodata=150), "surface model")
    assert np.isfinite(read).sum() == 200
    read = values_of(write(tmp_path / "f.tif", values, nodata=-1), "surface model")
    assert np.array_equal(read, values)


# ---- Systems with heights ------------------------------------------------------------------------


def feet_above_egm96(path: Path, values: NDArray[Any], code: int = 32767, key: int = 9003) -> Path:
    """A GeoTIFF in UTM with heights above EGM96, whose key names the unit of heights.

    rasterio writes such a key for a system without a code; its value is changed in the file.
    """
    parts = [pyproj.CRS("EPSG:32632").to_json_dict(), pyproj.CRS("EPSG:5773").to_json_dict()]
    foot = {"type": "LinearUnit", "name": "US survey foot", "conversion_factor": US_FOOT}
    parts[1]["coordinate_system"]["axis"][0]["unit"] = foot
    del parts[1]["id"]
    compound = {"type": "CompoundCRS", "name": "UTM with feet", "components": parts}
    write(path, values, crs=str(pyproj.CRS.from_json_dict(compound).to_wkt()))
    keys = (4096, 0, 1, 32767, 4097, 34737, 13, 14, 4098, 0, 1, 32767, 4099, 0, 1, 32767)
    datum = 32767 if code == 32767 else 5171
    named = (4096, 0, 1, code, *keys[4:11], datum, *keys[12:15], key)
    content = path.read_bytes()
    assert content.count(struct.pack("<16H", *keys)) == 1
    path.write_bytes(content.replace(struct.pack("<16H", *keys), struct.pack("<16H", *named)))
    return path


def test_units_of_the_system(tmp_path: Path, egm96: float) -> None:
    path = feet_above_egm96(tmp_path / "d.tif", (HILLS / US_FOOT).astype(np.float32))
    raster = Raster.open(path, "surface model")
    np.testing.assert_allclose(raster.patch(raster.grid.box).values, HILLS, atol=1e-3)
    # The system speaks metres too: 180 m above the sea are 228.25 m above the ellipsoid.
    place = raster.grid.projection.to_geodetic(np.array([500_000.0, 5_200_000.0, 180.0]))
    assert place.altitude == pytest.approx(180 + egm96, abs=0.01)
    assert raster.grid.projection.from_geodetic(place)[2] == pytest.approx(180, abs=0.01)
    assert raster.notes(place) == ()
    with pytest.raises(InputError, match="leave --undulation out"):
        raster.notes(place, 48.0)


def test_a_band_that_contradicts_the_system(tmp_path: Path, egm96: float) -> None:
    path = write(tmp_path / "d.tif", HILLS, crs="EPSG:32632+5773", after=unit("foot"))
    with pytest.raises(InputError, match="band's unit is unknown .it is 'foot', in the refe"):
        Raster.open(path, "surface model")


@pytest.mark.parametrize(
    ("key", "says"),
    [
        (9003, "VerticalUnitsGeoKey it is 0.3048"),
        (9002, "VerticalUnitsGeoKey it is 0.3048"),
        (9014, "VerticalUnitsGeoKey 9014 is not known"),
    ],
)
def test_keys_that_gdal_leaves_out(tmp_path: Path, egm96: float, key: int, says: str) -> None:
    """A code of a system in metres beside a key of feet: GDAL says metres."""
    path = feet_above_egm96(tmp_path / "d.tif", HILLS, 5773, key)
    with rasterio.open(path) as file:
        assert file.units == ("metre",)
    with pytest.raises(InputError, match=says):
        Raster.open(path, "surface model")
    metres = feet_above_egm96(tmp_path / "m.tif", HILLS, 5773, 9001)
    assert np.array_equal(values_of(metres, "surface model"), HILLS)


@pytest.mark.parametrize(
    "crs",
    [
        "EPSG:25832+5783",
        pytest.param("EPSG:25832+7837", marks=pytest.mark.thorough),
        pytest.param("EPSG:2180+5705", marks=pytest.mark.thorough),
        pytest.param("EPSG:6339+5703", marks=pytest.mark.thorough),
        "EPSG:6339+6360",
        "EPSG:7415",
        "EPSG:25832+5831",
    ],
)
def test_ballparks_are_refused(tmp_path: Path, crs: str) -> None:
    path = write(tmp_path / "d.tif", HILLS, crs=crs)
    with pytest.raises(InputError, match=r"surface model .*heights in .*"):
        Raster.open(path, "surface model")
    grey = write(tmp_path / "o.tif", np.zeros((1, 60, 80), np.uint8), crs=crs)
    assert Raster.open(grey, "orthophoto").grid.projection.height_unit_m is None
