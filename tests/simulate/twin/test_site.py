"""Sites built from rasters: heights, classes, albedo, report and refused files."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from pydantic import ValidationError
from rasterio.transform import from_origin

from objconnect.scene.bundle.labels import CLASSES
from objconnect.scene.errors import InputError
from objconnect.scene.geo.crs import Projection
from objconnect.scene.geo.rasters import Raster
from objconnect.scene.geometry.geodesy import geodetic_from_enu
from simulate.config import SimulateConfig
from simulate.look.conditions import condition
from simulate.look.sun import sun_position
from simulate.look.survey_albedo import bake_albedo, bake_specular
from simulate.place.site_files import load_site, save_site
from simulate.place.world import World
from simulate.twin.build import build_site
from simulate.twin.classes import CROWN, LOW_VEGETATION, PAVED, classify
from simulate.twin.options import SiteConfig
from simulate.twin.report import SiteReport
from simulate.twin.sampling import Cells, sample_colours, sample_heights
from simulate.twin.source import measure_extent
from simulate.twin.terrain import close_holes, drop_islands, estimate_ground, find_sunlit
from tests.simulate.twin.made_site import (
    HOUSE,
    ORIGIN,
    PIXEL_M,
    POND,
    ROOF_M,
    TREES,
    classes,
    ground,
    height,
    rasters,
)

AREA = 120.0


def build(folder: Path, **more: object) -> tuple[World, SiteReport]:
    given = more.pop("rasters", None) or rasters(folder)
    site = SiteConfig.model_validate({"ortho": given[0], "dsm": given[1], **more})
    return build_site(site, AREA, ORIGIN, 3, folder / "beside")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> tuple[World, SiteReport]:
    return build(tmp_path_factory.mktemp("site"))


def texels(world: World) -> tuple[np.ndarray, np.ndarray]:
    """East and north (n, n) of the centres of the texels."""
    n = len(world.ground.labels)
    axis = (np.arange(n) + 0.5 - 0.5 * n) * world.ground.texel_m
    return tuple(np.meshgrid(axis, axis))


def is_far_from_edges(x: np.ndarray, y: np.ndarray, metres: float) -> np.ndarray:
    """Whether points are this far from where classes change."""
    turn = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    own = classes(x, y)
    around = [classes(x + metres * np.cos(a), y + metres * np.sin(a)) == own for a in turn]
    return np.logical_and.reduce(around)


@pytest.mark.parametrize("crs", ["EPSG:32632", "EPSG:2056"])
def test_what_is_sampled_lies_where_proj_says(tmp_path: Path, crs: str) -> None:
    """Point by point, through exact coordinates and a bilinear interpolation of the test's own."""
    files = rasters(tmp_path, crs)
    axis = np.linspace(-65, 65, 261)  # finer than two pixels, of which means are read
    cells = Cells(axis, 3.0)
    z = sample_heights(Raster.open(files[1], "surface model"), ORIGIN, cells, 0.0)
    rgb = sample_colours(Raster.open(files[0], "orthophoto"), ORIGIN, cells)
    projection = Projection(crs)
    with rasterio.open(files[1]) as file:
        model, box = file.read(1).astype(float), file.bounds
    with rasterio.open(files[0]) as file:
        photo = file.read().astype(float)
    for row, column in np.random.default_rng(0).integers(0, 261, (300, 2)):
        point = np.array([axis[column], axis[row], z[row, column]])
        east, north, up = projection.from_geodetic(geodetic_from_enu(point, ORIGIN))
        u, v = (east - box.left) / PIXEL_M - 0.5, (box.top - north) / PIXEL_M - 0.5
        i, j = int(v), int(u)
        weights = np.outer([1 - (v - i), v - i], [1 - (u - j), u - j])
        around = model[i : i + 2, j : j + 2]
        # Weights are multiples of 1/32.
        assert (around * weights).sum() == pytest.approx(up, abs=0.002 + np.ptp(around) / 32)
        shown = (photo[:, i : i + 2, j : j + 2] * weights).sum((1, 2))
        most = np.ptp(photo[:, i : i + 2, j : j + 2], axis=(1, 2)).max() / 32
        np.testing.assert_allclose(rgb[row, column], shown, atol=0.3 + most)


def test_heights_are_those_of_the_place(site: tuple[World, SiteReport]) -> None:
    world, _ = site
    x, y = np.random.default_rng(0).uniform(-60, 60, (2, 4000))
    smooth = is_far_from_edges(x, y, 1.5) & (classes(x, y) != 17)
    off = np.abs(world.terrain.height(x, y) - height(x, y))[smooth]
    assert smooth.sum() > 2000
    assert np.percentile(off, 99) < 0.02


def test_classes_are_found(site: tuple[World, SiteReport]) -> None:
    world, report = site
    x, y = texels(world)
    truth, inner = classes(x, y), is_far_from_edges(x, y, 1.5)
    for label in (1, 4, 8, 16, 17):
        here = inner & (truth == label)
        assert here.sum() > 100
        assert (world.ground.labels[here] == label).mean() > 0.97, label
    assert sum(report.classes.values()) == pytest.approx(1, abs=0.01)


def test_flights_count_their_height_from_the_ground(site: tuple[World, SiteReport]) -> None:
    world, _ = site
    x, y = np.random.default_rng(1).uniform(-55, 55, (2, 4000))
    off = world.flight_ground.height(x, y) - ground(x, y)
    assert np.percentile(np.abs(off), 95) < 0.6
    on_roof = np.abs(x - np.mean(HOUSE[:2])) + np.abs(y - np.mean(HOUSE[2:])) < 5
    assert (off[on_roof] < 1.5).all() and on_roof.any()
    assert (world.bare_ground.nodes <= world.terrain.nodes + 1e-6).all()


def test_a_hill_is_no_building() -> None:
    axis = np.arange(-60, 60, 0.5)
    x, y = np.meshgrid(axis, axis)
    hill = (10 * np.exp(-(x**2 + y**2) / (2 * 30.0**2))).astype(np.float32)
    assert np.abs(estimate_ground(hill, 0.5) - hill).max() < 0.8


def test_holes_are_closed_and_said(tmp_path: Path) -> None:
    files = rasters(tmp_path, hole=(-5.0, 5.0, -5.0, 5.0))
    world, report = build(tmp_path, rasters=files)
    assert report.closed == pytest.approx(100 / AREA**2, rel=0.15)
    assert report.holes == 0
    assert any(note.startswith("closed: 0.8 %") for note in report.notes)
    x, y = np.random.default_rng(2).uniform(-5, 5, (2, 100))
    assert np.abs(world.terrain.height(x, y) - ground(x, y)).max() < 0.5


def test_too_large_holes_are_refused(tmp_path: Path) -> None:
    files = rasters(tmp_path, hole=(-60.0, 60.0, -60.0, 10.0))
    with pytest.raises(InputError, match="5. % of the place have no data in the surface model"):
        build(tmp_path, rasters=files)


def test_a_hole_takes_its_nearest_neighbours() -> None:
    values = np.zeros((40, 40), np.float32)
    values[:, 20:] = 10
    values[10:30, 10:15] = np.nan
    closed, hole = close_holes(values, 1.0)
    assert hole.sum() == 100
    assert np.abs(closed[hole]).max() < 0.01
    assert (closed[~hole] == values[~hole]).all()


def test_a_large_hole_has_no_steps() -> None:
    """Its two sides differ by 10 m; in the middle, a step would have all of it between cells."""
    values = np.zeros((240, 240), np.float32)
    values[:, 120:] = 10
    values[:, 60:180] = np.nan
    closed, _ = close_holes(values, 0.5)
    assert np.abs(np.diff(closed, axis=1)).max() < 0.3
    assert np.abs(closed[:, 60:64]).max() < 0.2
    assert np.abs(closed[:, 176:180] - 10).max() < 0.2


def test_woods_without_heights_are_crowns() -> None:
    """They have the grain of leaves; a lawn has not, and a grainy pavement is not green."""
    rng = np.random.default_rng(4)
    shade = cv2.resize(rng.uniform(0.2, 1.8, (150, 150)).astype(np.float32), (300, 300))[..., None]
    green, grey = (np.array(colour, np.float32) for colour in ((70, 110, 50), (120, 110, 120)))
    rgb = np.broadcast_to(green, (300, 300, 3)).copy()
    rgb[:, :100] *= shade[:, :100]
    rgb[:, 200:] = grey * shade[:, 200:]
    level = np.zeros((300, 300), np.float32)
    found = classify(rgb, level, level, 0.1, np.ones((300, 300), bool))
    for columns, label in (
        (slice(20, 80), CROWN),
        (slice(120, 180), LOW_VEGETATION),
        (slice(220, 280), PAVED),
    ):
        assert (found[:, columns] == label).mean() > 0.95
    assert not (classify(rgb, level, level, 0.1) == CROWN).any()


def test_islands_are_dropped() -> None:
    surface = np.full((80, 80), np.nan, np.float32)
    surface[:, :40] = 5
    surface[10:14, 60:64] = 30  # 4 m2
    surface[40:60, 50:70] = 7  # 100 m2
    kept = drop_islands(surface, 0.5)
    assert np.isnan(kept[10:14, 60:64]).all()
    np.testing.assert_array_equal(kept[30:], surface[30:])


def test_rasters_that_do_not_overlap(tmp_path: Path) -> None:
    ortho, dsm = rasters(tmp_path, east_m=500.0)
    with pytest.raises(InputError, match="do not overlap"):
        measure_extent(SiteConfig(ortho=ortho, dsm=dsm))
    with pytest.raises(InputError, match="do not both show the origin"):
        build(tmp_path, rasters=(ortho, dsm))


def test_the_extent_is_the_square_that_both_show(tmp_path: Path) -> None:
    ortho, dsm = rasters(tmp_path, east_m=10.0)
    found = measure_extent(SiteConfig(ortho=ortho, dsm=dsm))
    # 141.8 m a side in the grid, which is turned by 0.73 degrees against the world.
    assert found.side_m == pytest.approx(130, abs=2)
    assert found.origin.longitude > ORIGIN.longitude
    assert found.origin.altitude == pytest.approx(ORIGIN.altitude, abs=1)
    config = SimulateConfig.load(None, {"preset": "site", "site.ortho": ortho, "site.dsm": dsm})
    assert (config.area, config.origin) == (found.side_m, found.origin)
    small = rasters(tmp_path / "small", half_m=18.0)
    with pytest.raises(InputError, match="a square of 3. m in common"):
        measure_extent(SiteConfig(ortho=small[0], dsm=small[1]))


def test_shadows_fall_as_the_sun_stands() -> None:
    surface = np.zeros((200, 200), np.float32)
    surface[98:102, 98:102] = 10.0
    lit = find_sunlit(surface, 0.5, azimuth=90.0, elevation=45.0)  # from the east
    assert not lit[100, 80:97].any(), "10 m to the west lie in the shade"
    assert lit[100, :76].all() and lit[100, 102:].all()
    assert lit[:96].all() and lit[104:].all()
    assert lit[100, 100]


def test_known_shadows_are_softened_and_others_remain(tmp_path: Path) -> None:
    taken = datetime(2026, 7, 1, 7, 0, tzinfo=UTC)
    sun = sun_position(taken, ORIGIN)
    reach = ROOF_M / np.tan(np.radians(sun.elevation))
    east, north = np.sin(np.radians(sun.azimuth)), np.cos(np.radians(sun.azimuth))

    def shade_place(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        steps = np.arange(0.25, reach, 0.25)
        rise = np.tan(np.radians(sun.elevation))
        own = height(x, y)
        return np.logical_or.reduce(
            [height(x + s * east, y + s * north) > own + s * rise for s in steps]
        )

    files = rasters(tmp_path, shaded=shade_place)
    before, said = build(tmp_path, rasters=files)
    after, softened = build(tmp_path, rasters=files, taken=taken)
    assert said.sun is None and any("shadows of the orthophoto remain" in n for n in said.notes)
    assert softened.sun == pytest.approx(tuple(sun), abs=0.01)
    assert not any("shadows" in note for note in softened.notes)
    x, y = texels(before)
    grass = is_far_from_edges(x, y, 1.5) & (classes(x, y) == 1)
    lawn = np.hypot(x - np.mean(HOUSE[:2]), y - np.mean(HOUSE[2:])) < 25
    deep = grass.copy()
    for dx in (0, -1, 1):
        for dy in (0, -1, 1):  # of what is left: the first leaves the shadows alone
            deep[deep] = shade_place(x[deep] + dx, y[deep] + dy)
    assert (lawn & deep).sum() > 100
    ratio = {}
    for name, world in (("before", before), ("after", after)):
        value = world.imagery.albedo.mean(-1)
        ratio[name] = np.median(value[deep]) / np.median(value[grass & lawn & ~deep])
    assert ratio["before"] < 0.55
    assert 0.8 < ratio["after"] < 1.2


def test_snow_lies_by_slope_shelter_and_class(site: tuple[World, SiteReport]) -> None:
    world, _ = site
    x, y = texels(world)
    snow = world.imagery.snow / 255
    truth, inner = classes(x, y), is_far_from_edges(x, y, 3.0)
    assert np.median(snow[inner & (truth == 1)]) > 0.95
    assert np.median(snow[inner & (truth == 16)]) > 0.95
    assert (snow[inner & (truth == 8)] == 0).mean() > 0.99
    assert np.median(snow[inner & (truth == 4)]) == pytest.approx(0.4, abs=0.02)
    west, _, south, north = HOUSE
    between = (y > south + 2) & (y < north - 2)
    wall = between & (np.abs(x - west) < 0.8)
    assert np.where(wall, snow, 1).min(1)[wall.any(1)].mean() < 0.05
    beside, off = between & (np.abs(x - west + 1.5) < 0.3), between & (np.abs(x - west + 6) < 0.3)
    assert snow[beside].mean() < snow[off].mean() - 0.03


def test_seasons_change_what_grows_and_no_roofs(site: tuple[World, SiteReport]) -> None:
    world, _ = site
    x, y = texels(world)
    truth, inner = classes(x, y), is_far_from_edges(x, y, 3.0)

    def mean(name: str, label: int) -> np.ndarray:
        return bake_albedo(world, condition(name))[inner & (truth == label)].mean(0)

    for label in (16, 8):
        np.testing.assert_allclose(mean("summer-noon", label), mean("autumn-noon", label), atol=1)
    red, green, _ = mean("autumn-noon", 17)
    assert red > green, "crowns turn in autumn"
    red, green, _ = mean("summer-noon", 17)
    assert green > red
    assert mean("snow-noon", 1).min() > 190 > 140 > mean("snow-noon", 4).max()
    wet, dry = mean("summer-noon-wet", 4), mean("summer-noon", 4)
    assert (wet < 0.8 * dry).all()
    assert (bake_albedo(world, condition("summer-noon")) == world.imagery.albedo).mean() > 0.99


def test_water_mirrors_and_rain_leaves_puddles(site: tuple[World, SiteReport]) -> None:
    world, _ = site
    x, y = texels(world)
    west, east, south, north = POND
    pond = (x > west + 3) & (x < east - 3) & (y > south + 3) & (y < north - 3)
    dry = bake_specular(world, condition("summer-noon"))
    wet = bake_specular(world, condition("summer-noon-wet"))
    assert (dry[pond] == 255).mean() > 0.97
    yard = (classes(x, y) == 4) & is_far_from_edges(x, y, 2.0)
    assert dry[yard].max() == 0 and wet[yard].mean() > 20


def test_floods_lie_on_low_meadows_of_sites(site: tuple[World, SiteReport]) -> None:
    world, _ = site
    dry, flooded = (
        bake_specular(world, condition(name)) for name in ("summer-noon", "summer-noon-flood")
    )
    new = (flooded > 200) & (dry < 200)
    assert new.any()
    assert (world.ground.labels[new] == CLASSES["grass"]).all()
    x, y = texels(world)
    height = world.flight_ground.height(x, y)
    assert height[new].max() < np.quantile(height[world.ground.labels == CLASSES["grass"]], 0.6)
    browner = bake_albedo(world, condition("summer-noon-flood"))[new].mean()
    assert browner < bake_albedo(world, condition("summer-noon"))[new].mean()


def test_given_classes_win(tmp_path: Path) -> None:
    files = rasters(tmp_path)
    with rasterio.open(files[0]) as file:
        kind = {"driver": "GTiff", "width": file.width, "height": file.height, "crs": file.crs}
        mask = np.zeros((file.height, file.width), np.uint8)
        mask[:, : file.width // 2] = 4
        with rasterio.open(
            tmp_path / "mask.tif", "w", count=1, dtype="uint8", transform=file.transform, **kind
        ) as out:
            out.write(mask, 1)
            box = file.bounds
    world, _ = build(tmp_path, rasters=files, classes=tmp_path / "mask.tif")
    x, y = texels(world)
    assert (world.ground.labels[x < -2] == 4).all()
    tree = np.hypot(x - TREES[0][0], y - TREES[0][1]) < 2
    assert (world.ground.labels[tree] == 17).mean() > 0.95
    mask[0, 0] = mask[50, 50] = 99
    transform = from_origin(box.left, box.top, PIXEL_M, PIXEL_M)
    with rasterio.open(
        tmp_path / "mask.tif", "w", count=1, dtype="uint8", transform=transform, **kind
    ) as out:
        out.write(mask, 1)
    with pytest.raises(InputError, match="has the value 99"):
        build(tmp_path, rasters=files, classes=tmp_path / "mask.tif")


def test_a_surveyed_place_is_kept(site: tuple[World, SiteReport], tmp_path: Path) -> None:
    world, _ = site
    path = tmp_path / "site" / "place.npz"
    save_site(path, world)
    again = load_site(path, world.seed)
    assert (again.ground.labels == world.ground.labels).all()
    assert (again.imagery.albedo == world.imagery.albedo).all()
    np.testing.assert_array_equal(again.terrain.nodes, world.terrain.nodes)
    assert (again.side_m, again.margin_m) == (world.side_m, world.margin_m)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(InputError, match=r"place\.npz is missing or damaged"):
        load_site(path, 0)


def test_configurations_of_sites(tmp_path: Path) -> None:
    ortho, dsm = rasters(tmp_path)
    with pytest.raises(InputError, match="needs --from SCENE, or --ortho and --dsm"):
        SimulateConfig.load(None, {"preset": "site"})
    with pytest.raises(InputError, match="either an orthophoto with a surface model, or a scene"):
        SimulateConfig.load(None, {"preset": "site", "site.ortho": ortho})
    with pytest.raises(InputError, match="files of a site need --preset site"):
        SimulateConfig.load(None, {"preset": "town", "site.ortho": ortho, "site.dsm": dsm})
    with pytest.raises(ValidationError, match="needs a time zone"):
        SiteConfig.model_validate({"ortho": ortho, "dsm": dsm, "taken": "2026-07-01T10:00:00"})
    site = SiteConfig(ortho=ortho, dsm=dsm)
    rasters(tmp_path, hole=(0, 1, 0, 1))
    with pytest.raises(InputError, match="has changed since"):
        build_site(site, AREA, ORIGIN, 0, tmp_path)
