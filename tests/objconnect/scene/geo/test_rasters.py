"""GeoTIFFs, against files that rasterio wrote and tags that Pillow reads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from PIL import Image
from rasterio.transform import Affine, from_origin

from objconnect.scene.errors import InputError
from objconnect.scene.geo.crs import Projection
from objconnect.scene.geo.rasters import NO_HEIGHT, Box, Grid, Kind, Patch, Raster, raster_writer

UPRIGHT = from_origin(500_000.0, 5_200_000.0, 0.5, 0.5)
HEIGHTS = np.arange(48, dtype=np.float32).reshape(1, 6, 8) + 400


def write(path: Path, values: np.ndarray, **profile: Any) -> Path:
    """A GeoTIFF of (bands, H, W), upright in UTM unless told otherwise."""
    bands, height, width = values.shape
    size = {"driver": "GTiff", "count": bands, "height": height, "width": width}
    place = {"crs": "EPSG:32632", "transform": UPRIGHT, "dtype": values.dtype}
    with rasterio.open(path, "w", **size | place | profile) as file:
        file.write(values)
    return path


@pytest.fixture
def dsm(tmp_path: Path) -> Path:
    return write(tmp_path / "dsm.tif", HEIGHTS)


def test_grid_and_values(dsm: Path) -> None:
    raster = Raster.open(dsm, "surface model")
    assert raster.grid.box == Box(500_000.0, 5_199_997.0, 500_004.0, 5_200_000.0)
    assert raster.grid.projection.name == "WGS 84 / UTM zone 32N"
    patch = raster.patch(raster.grid.box)
    assert np.array_equal(patch.values, HEIGHTS)
    column, row = patch.grid.columns_rows(np.array([500_000.25]), np.array([5_199_999.75]))
    assert (column[0], row[0]) == (0.5, 0.5)


@pytest.mark.parametrize(
    ("dtype", "says"),
    [
        ("uint16", r"type uint16: gdal_translate -ot Byte -scale makes 8 bits$"),
        ("float32", r"type float32: gdal_translate -a_nodata 0 .* 1 255 .*undeclared NaN would"),
    ],
)
def test_orthophotos_of_other_types_are_told_how_to_convert(
    tmp_path: Path, dtype: str, says: str
) -> None:
    path = write(tmp_path / "ortho.tif", np.ones((3, 6, 8), dtype), photometric="RGB")
    with pytest.raises(InputError, match=says) as error:
        Raster.open(path, "orthophoto")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("crs", "left", "top"),
    [
        ("EPSG:32632", 5_200_000, 500_000),  # exchanged
        ("EPSG:32632", 0, 5_200_000),  # without its false easting
        ("EPSG:31467", 500_000, 5_300_000),  # without the number of its zone
        ("EPSG:2048", -50_000, -3_000_000),  # counted to the east and north, not west and south
        ("EPSG:32632", 1_640_000, 17_060_000),  # in feet
    ],
)
def test_a_place_beside_its_system_is_told(
    tmp_path: Path, crs: str, left: float, top: float
) -> None:
    place = from_origin(left, top, 0.5, 0.5)
    path = write(tmp_path / "d.tif", HEIGHTS.astype(np.uint8), crs=crs, transform=place)
    raster = Raster.open(path, "class mask")
    assert "far outside the area that" in raster.notes(raster.grid.middle)[-1]


def test_a_place_that_no_system_has_is_named(tmp_path: Path) -> None:
    place = from_origin(32_500_000, 5_300_000, 0.5, 0.5)
    path = write(tmp_path / "d.tif", HEIGHTS, crs="EPSG:25832", transform=place)
    with pytest.raises(InputError, match=r"d\.tif: .* is not a position in ETRS89 / UTM"):
        Raster.open(path, "surface model")


def test_a_patch_covers_its_box_and_knows_its_place(dsm: Path) -> None:
    patch = Raster.open(dsm, "surface model").patch(
        Box(500_001.1, 5_199_998.1, 500_001.9, 5e6 + 2e5 - 1.1)
    )
    # Columns 2 and 3, rows 2 and 3, and one more on each side.
    assert np.array_equal(patch.values, HEIGHTS[:, 1:5, 1:5])
    assert (patch.grid.left, patch.grid.top) == (500_000.5, 5_199_999.5)


def test_larger_pixels_are_means(tmp_path: Path) -> None:
    values = HEIGHTS.copy()
    values[0, 0, 0] = values[0, 2, 4] = np.nan
    values[0, 2:4, 6:8] = np.nan
    raster = Raster.open(write(tmp_path / "d.tif", values), "surface model")
    patch = raster.patch(raster.grid.box, 1.0)
    expected = np.array(
        [
            [(401 + 408 + 409) / 3, 406.5, 408.5, 410.5],
            [420.5, 422.5, (421 + 428 + 429) / 3, np.nan],
            [436.5, 438.5, 440.5, 442.5],
        ]
    )
    assert patch.grid.pixel == (1.0, 1.0)
    assert np.allclose(patch.values[0], expected, equal_nan=True)


def test_no_data_declared_or_not(tmp_path: Path) -> None:
    values = HEIGHTS.copy()
    values[0, 0, :4] = (-32767.0, 7.0, 3.4e38, np.inf)
    raster = Raster.open(write(tmp_path / "d.tif", values, nodata=7.0), "surface model")
    read = raster.patch(raster.grid.box).values
    assert np.isnan(read[0, 0, :4]).all()
    assert np.isfinite(read).sum() == values.size - 4


def test_beyond_the_raster_is_no_data(dsm: Path) -> None:
    patch = Raster.open(dsm, "surface model").patch(Box(600_000.0, 0.0, 600_001.0, 1.0))
    assert np.isnan(patch.values).all()


def test_a_position_of_pixel_centres_is_shifted(tmp_path: Path) -> None:
    path = tmp_path / "d.tif"
    with rasterio.open(
        path, "w", driver="GTiff", count=1, height=6, width=8, dtype="float32",
        crs="EPSG:32632", transform=UPRIGHT,
    ) as file:  # fmt: skip
        file.update_tags(AREA_OR_POINT="Point")
        file.write(HEIGHTS)
    with Image.open(path) as image:
        tie = image.tag_v2[33922]  # ModelTiepointTag: column, row, 0, east, north, 0
    assert tie[:2] == (0.0, 0.0) and tie[3] == 500_000.25
    assert Raster.open(path, "surface model").grid.left == 500_000.0


def test_strips_are_the_whole(dsm: Path) -> None:
    strips = list(Raster.open(dsm, "surface model").strips(4))
    assert [strip.values.shape for strip in strips] == [(1, 4, 8), (1, 2, 8)]
    assert strips[1].grid.top == 5_199_998.0
    assert np.array_equal(np.concatenate([s.values for s in strips], 1), HEIGHTS)


def test_colours_of_one_three_and_four_bands(tmp_path: Path) -> None:
    rgba = np.random.default_rng(0).integers(0, 255, (4, 6, 8), dtype=np.uint8)
    rgba[3] = 255
    rgba[3, 0, 0] = 0
    four = write(tmp_path / "4.tif", rgba, photometric="rgb", alpha="yes")
    read = Raster.open(four, "orthophoto").patch(Box(0, 0, 1e7, 1e7)).values
    assert read.shape == (3, 6, 8) and np.isnan(read[:, 0, 0]).all()
    assert np.array_equal(read[:, 1:], rgba[:3, 1:])
    grey = write(tmp_path / "1.tif", rgba[:1])
    assert Raster.open(grey, "orthophoto").bands == (1,)


def test_what_is_written_is_read_by_others(tmp_path: Path) -> None:
    grid = Grid(Projection("EPSG:2056"), 2_600_000.0, 1_200_000.0, (0.25, 0.25), 300, 280)
    values = np.random.default_rng(0).uniform(0, 255, (3, 280, 300)).astype(np.float32)
    values[:, 5, 7] = np.nan
    kinds: list[tuple[Kind, np.ndarray]] = [("orthophoto", values), ("surface model", values[:1])]
    for kind, pixels in kinds:
        with raster_writer(tmp_path / kind, kind, grid) as put:
            for row, rows in ((0, slice(0, 200)), (200, slice(200, 280))):
                part = pixels[:, rows]
                put(Patch(grid.part(row, 0, part.shape[1], 300), part))
    with rasterio.open(tmp_path / "orthophoto") as file:
        assert file.crs.to_epsg() == 2056 and file.transform == from_origin(
            2.6e6, 1.2e6, 0.25, 0.25
        )
        assert np.array_equal(file.read((1, 2, 3)), np.rint(np.nan_to_num(values)))
        assert np.argwhere(file.dataset_mask() == 0).tolist() == [[5, 7]]
    with rasterio.open(tmp_path / "surface model") as file:
        assert file.nodata == NO_HEIGHT and file.dtypes == ("float32",)
        assert file.read(1)[5, 7] == NO_HEIGHT
        assert np.array_equal(file.read(1)[values[0] > 0], values[0][values[0] > 0])


COLOURS = np.zeros((3, 6, 8), np.uint8)
REFUSED: dict[str, tuple[Kind, np.ndarray, dict[str, Any], str]] = {
    "no system": ("surface model", HEIGHTS, {"crs": None}, "no coordinate reference system"),
    "degrees": ("surface model", HEIGHTS, {"crs": "EPSG:4326"}, "units are not metres"),
    "feet": ("surface model", HEIGHTS, {"crs": "EPSG:2263"}, "units are not metres"),
    "turned": (
        "surface model", HEIGHTS, {"transform": UPRIGHT @ Affine.rotation(10)}, "is rotated",
    ),
    "south above": (
        "surface model", HEIGHTS, {"transform": Affine(1, 0, 5e5, 0, 1, 5e6)}, "upside down",
    ),
    "no place": ("surface model", HEIGHTS, {"transform": Affine.identity()}, "no geotransform"),
    "a colour as heights": ("surface model", COLOURS, {}, "3 bands, heights are one band"),
    "complex": ("surface model", HEIGHTS.astype(np.complex64), {}, "not heights"),
    "two bands": ("orthophoto", COLOURS[:2], {}, "has 2 bands"),
    "sixteen bits": ("orthophoto", COLOURS.astype(np.uint16), {}, "-ot Byte"),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("case", REFUSED)
def test_what_is_refused(case: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    kind, values, profile, says = REFUSED[case]
    path = write(tmp_path / "r.tif", values, **profile)
    with pytest.raises(InputError, match=says) as error:
        Raster.open(path, kind)
    assert str(path) in str(error.value) and "\n" not in str(error.value)
    assert not capfd.readouterr().err


def test_what_is_damaged(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    text = tmp_path / "t.tif"
    text.write_text("no raster")
    noise = np.random.default_rng(0).uniform(0, 1, (1, 400, 400)).astype(np.float32)
    cut = write(tmp_path / "c.tif", noise)
    cut.write_bytes(cut.read_bytes()[:300_000])
    for path in (text, tmp_path / "missing.tif", tmp_path):
        with pytest.raises(InputError, match=r"surface model .*"):
            Raster.open(path, "surface model")
    with pytest.raises(InputError, match="is damaged"):
        list(Raster.open(cut, "surface model").strips())
    assert not capfd.readouterr().err


def test_what_would_fill_the_memory(tmp_path: Path) -> None:
    profile = {"driver": "GTiff", "count": 1, "dtype": "float32", "sparse_ok": True}
    place = {"crs": "EPSG:32632", "transform": UPRIGHT, "width": 40_000, "height": 40_000}
    for name, more in (
        ("one strip", {"blockysize": 40_000, "compress": "deflate"}),
        ("tiles", {"tiled": True, "blockxsize": 256, "blockysize": 256}),
    ):
        with rasterio.open(tmp_path / name, "w", **profile, **place, **more):
            pass
    with pytest.raises(InputError, match="TILED=YES"):
        Raster.open(tmp_path / "one strip", "surface model")
    huge = Raster.open(tmp_path / "tiles", "surface model")
    with pytest.raises(InputError, match="do not fit in memory"):
        huge.patch(huge.grid.box)


def test_without_the_extra(dsm: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "rasterio", None)
    with pytest.raises(InputError, match=r"pip install 'objconnect\[geo\]'"):
        Raster.open(dsm, "surface model")
