"""Palettes, the order of colours, and pixels without data of orthophotos."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from objconnect.scene.errors import InputError
from objconnect.scene.geo.grids import Grid
from objconnect.scene.geo.rasters import Raster
from objconnect.scene.quantities.bands import colour_bands
from tests.objconnect.scene.geo.raster_files import interpret, values_of, write

RNG = np.random.default_rng(5)
RGB = RNG.integers(1, 256, (3, 12, 16), dtype=np.uint8)
BANDS = dict(zip(("red", "green", "blue"), RGB, strict=True))
OTHER = RNG.integers(1, 256, (12, 16), dtype=np.uint8)
SOLID = np.full((12, 16), 255, np.uint8)


def stack(*names: str) -> np.ndarray:
    """Bands by name; what is not a colour is noise, alpha is solid."""
    return np.stack([BANDS.get(n, SOLID if n == "alpha" else OTHER) for n in names])


@pytest.mark.parametrize(
    "order",
    [
        "red green blue",
        "blue green red",
        "blue green red undefined",
        "undefined red green blue",
        "nir red green blue",
        "alpha red green blue",
        "green blue red alpha",
        "red green blue nir rededge",
        "coastal blue green red nir alpha",
    ],
)
def test_orders_of_colours(tmp_path: Path, order: str) -> None:
    names = order.split()
    path = write(tmp_path / "o.tif", stack(*names), after=interpret(*names))
    assert np.array_equal(values_of(path, "orthophoto"), RGB)


def test_descriptions_where_nothing_else_tells(tmp_path: Path) -> None:
    def say(file: Any) -> None:
        file.descriptions = ["Band 1 (Blue)", "green", "Red", "NIR"]

    values = stack("blue", "green", "red", "nir")
    path = write(tmp_path / "o.tif", values, after=say, photometric="minisblack")
    assert np.array_equal(values_of(path, "orthophoto"), RGB)


@pytest.mark.parametrize(
    "words", ["Bleu Vert Rouge", "Blau Grün Rot", "azul verde rojo", "blu verde rosso", "B G R"]
)
def test_descriptions_in_other_languages(tmp_path: Path, words: str) -> None:
    def say(file: Any) -> None:
        file.descriptions = words.split()

    values = stack("blue", "green", "red")
    path = write(tmp_path / "o.tif", values, after=say, photometric="minisblack")
    assert np.array_equal(values_of(path, "orthophoto"), RGB)
    # GDAL calls three bands red, green and blue where its user does not say what they are.
    with pytest.raises(InputError, match="ColorInterp of band 1 is red, its description"):
        Raster.open(write(tmp_path / "p.tif", values, after=say), "orthophoto")


@pytest.mark.parametrize(
    ("interpretations", "descriptions", "says"),
    [
        ("gray undefined undefined", "", "3 bands: gray, undefined, undefined"),
        ("red undefined undefined", "", "red, undefined, undefined"),
        ("red green red", "", "red, green, red"),
        ("gray undefined undefined undefined undefined", "", "5 bands"),
        ("cyan magenta yellow black", "", "cyan, magenta"),
        ("hue saturation lightness", "", "hue, saturation"),
        ("gray undefined", "", "2 bands"),
        ("red", "", "1 bands: red"),
        (
            "red green blue",
            "blue green red",
            "ColorInterp of band 1 is red, its description 'blue'",
        ),
        ("red green blue alpha", "red green blue NIR", "band 4 is alpha, its description 'NIR'"),
        ("red green blue", "PIR Rouge Vert", "band 1 is red, its description 'PIR'"),
        ("alpha red green blue alpha", "", "alpha, red"),
    ],
)
def test_unknown_orders_are_named(
    tmp_path: Path, interpretations: str, descriptions: str, says: str
) -> None:
    names = interpretations.split()

    def say(file: Any) -> None:
        interpret(*names)(file)
        if descriptions:
            file.descriptions = descriptions.split()

    found = colour_bands(names, descriptions.split())
    assert not found.is_known and says in found.why
    if len(set(names) & {"hue", "cyan", "alpha"}) and "alpha red" in interpretations:
        return  # GDAL keeps one alpha band
    path = write(tmp_path / "o.tif", stack(*names), after=say, photometric="minisblack")
    with pytest.raises(InputError, match="ColorInterp is unknown .*gdal_edit -colorinterp_1"):
        Raster.open(path, "orthophoto")


@pytest.mark.parametrize("space", ["cmyk", "cielab"])
def test_other_colour_spaces_are_named(tmp_path: Path, space: str) -> None:
    values = np.concatenate([RGB, OTHER[None]])[: 4 if space == "cmyk" else 3]
    path = write(tmp_path / "o.tif", values, photometric=space)
    with pytest.raises(InputError, match=f"colours in {space.upper()}: convert it to RGB"):
        Raster.open(path, "orthophoto")


def test_white_is_zero(tmp_path: Path) -> None:
    path = write(tmp_path / "o.tif", RGB[:1], photometric="miniswhite")
    assert np.array_equal(values_of(path, "orthophoto"), 255 - RGB[:1].astype(int))


def test_scales_that_differ(tmp_path: Path) -> None:
    def say(file: Any) -> None:
        file.scales = [1.0, 0.5, 1.0]

    with pytest.raises(InputError, match="different scales or offsets"):
        Raster.open(write(tmp_path / "o.tif", RGB, after=say), "orthophoto")


# ---- Palettes ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("bits", "dtype", "count"),
    [(8, "uint8", 256), (1, "uint8", 2), (4, "uint8", 16), (16, "uint16", 900)],
)
def test_palettes(tmp_path: Path, bits: int, dtype: str, count: int) -> None:
    table = RNG.integers(0, 256, (count, 3))
    numbers = RNG.integers(0, count, (1, 12, 16)).astype(dtype)

    def say(file: Any) -> None:
        file.write_colormap(1, {k: (*map(int, table[k]), 255) for k in range(count)})

    more = {} if bits in (8, 16) else {"nbits": bits}
    path = write(tmp_path / "o.tif", numbers, after=say, **more)
    read = values_of(path, "orthophoto")
    assert np.array_equal(read, np.moveaxis(table[numbers[0]], -1, 0))
    mean = Raster.open(path, "orthophoto")
    coarse = mean.patch(mean.grid.box, 1.0).values
    colours = np.moveaxis(table[numbers[0]], -1, 0).reshape(3, 6, 2, 8, 2)
    np.testing.assert_allclose(coarse, colours.mean((2, 4)), atol=1e-3)


def test_the_number_of_no_data_in_a_palette(tmp_path: Path) -> None:
    numbers = RNG.integers(0, 4, (1, 12, 16)).astype(np.uint8)

    def say(file: Any) -> None:
        file.write_colormap(1, {k: (10 * k, 20, 30, 255) for k in range(4)})

    path = write(tmp_path / "o.tif", numbers, nodata=2, after=say)
    read = values_of(path, "orthophoto")
    assert np.array_equal(np.isnan(read[0]), numbers[0] == 2)
    assert np.array_equal(
        values_of(path, "class mask")[0][numbers[0] == 3], [3] * (numbers == 3).sum()
    )


def test_a_palette_is_no_height(tmp_path: Path) -> None:
    def say(file: Any) -> None:
        file.write_colormap(1, {0: (1, 2, 3, 255)})

    with pytest.raises(InputError, match="palette, not heights"):
        Raster.open(write(tmp_path / "d.tif", RGB[:1], after=say), "surface model")


# ---- No data -------------------------------------------------------------------------------------


@pytest.mark.parametrize("nodata", [0, 255, 7])
def test_one_band_of_no_data_is_a_colour(tmp_path: Path, nodata: int) -> None:
    values = RGB.copy()
    values[0, :4] = nodata  # water without red
    values[:, 6:8, 3:9] = nodata
    truth = values.astype(float)
    truth[:, (values == nodata).all(0)] = np.nan
    for order in ("red green blue", "blue green red", "undefined red green blue"):
        bands = {**dict(zip(("red", "green", "blue"), values, strict=True)), "undefined": OTHER}
        names = order.split()
        stored = np.stack([bands[name] for name in names])
        path = write(tmp_path / "o.tif", stored, nodata=nodata, after=interpret(*names))
        np.testing.assert_array_equal(values_of(path, "orthophoto"), truth)


def test_real_black_stays(tmp_path: Path) -> None:
    values = RGB.copy()
    values[:, 2:5, 2:5] = 0
    assert np.array_equal(values_of(write(tmp_path / "o.tif", values), "orthophoto"), values)
    holes = np.full((12, 16), 255, np.uint8)
    holes[9] = 0

    def mask(file: Any) -> None:
        file.write_mask(holes)

    path = write(tmp_path / "m.tif", values, after=mask, nodata=0)
    assert np.array_equal(np.isnan(values_of(path, "orthophoto")[0]), holes == 0)
    alpha = np.concatenate([holes[None], values])
    path = write(tmp_path / "a.tif", alpha, after=interpret("alpha", "red", "green", "blue"))
    read = values_of(path, "orthophoto")
    assert np.array_equal(np.isnan(read[0]), holes == 0)
    assert np.array_equal(read[:, holes > 0], values[:, holes > 0])


# ---- The ground of a pixel, and its place --------------------------------------------------------


@pytest.mark.parametrize(
    ("crs", "latitude", "metres"),
    [
        ("EPSG:3857", 60.0, (0.25, 0.25)),
        ("EPSG:3857", 45.0, (0.354, 0.354)),
        ("EPSG:3395", 60.0, (0.25, 0.25)),
        ("ESRI:54001", 60.0, (0.25, 0.5)),
        ("EPSG:32632", 60.0, (0.5, 0.5)),
        ("EPSG:2056", 47.0, (0.5, 0.5)),
    ],
)
def test_pixels_on_the_ground(crs: str, latitude: float, metres: tuple[float, float]) -> None:
    from objconnect.scene.geo.crs import Projection
    from objconnect.scene.geometry.geodesy import Geodetic

    projection = Projection(crs)
    east, north, _ = projection.from_geodetic(Geodetic(latitude, 8.5, 0.0))
    grid = Grid(projection, east, north, (0.5, 0.5), 100, 100)
    np.testing.assert_allclose(grid.ground_pixel, metres, rtol=0.01)


def test_patches_of_mercator_have_the_ground_that_is_asked_for(tmp_path: Path) -> None:
    place = from_origin(1_000_000.0, 8_400_000.0, 0.5, 0.5)  # at 60 degrees: 25 cm on the ground
    path = write(tmp_path / "o.tif", RGB, crs="EPSG:3857", transform=place)
    raster = Raster.open(path, "orthophoto")
    assert raster.patch(raster.grid.box, 0.52).grid.pixel == (1.0, 1.0)
    assert raster.patch(raster.grid.box, 0.45).grid.pixel == (0.5, 0.5)


@pytest.mark.parametrize(
    ("numbers", "agrees"),
    [
        ("0.5 0 0 -0.5 500000.25 5199999.75", True),
        ("0.5 0 0 -0.5 500000.0 5200000.0", True),
        ("0.5 0 0 -0.5 500100.0 5200000.0", False),
        ("0.25 0 0 -0.25 500000.0 5200000.0", False),
        ("0.5 0 0 -0.5 -91.9 46.8", False),
        ("no numbers", True),
    ],
)
@pytest.mark.parametrize("end", [".tfw", ".wld"])
def test_a_world_file_beside(tmp_path: Path, numbers: str, agrees: bool, end: str) -> None:
    path = write(tmp_path / "o.tif", RGB)
    path.with_suffix(end).write_text(numbers.replace(" ", "\n"))
    if agrees:
        assert Raster.open(path, "orthophoto").grid.left == 500_000.0
    else:
        with pytest.raises(InputError, match="state different positions"):
            Raster.open(path, "orthophoto")


def test_a_place_by_control_points(tmp_path: Path) -> None:
    path = tmp_path / "o.tif"
    points = [
        rasterio.control.GroundControlPoint(r, c, 5e5 + c, 5.2e6 - r)
        for r in (0, 12)
        for c in (0, 16)
    ]
    with rasterio.open(
        path, "w", driver="GTiff", count=3, height=12, width=16, dtype="uint8"
    ) as file:
        file.gcps = (points, rasterio.crs.CRS.from_epsg(32632))
        file.write(RGB)
    with pytest.raises(InputError, match="by ground control points: gdalwarp"):
        Raster.open(path, "orthophoto")
