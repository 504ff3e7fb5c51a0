"""Make the scene of an orthophoto: virtual photographs with exact poses and depth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.virtual.flight import camera_of, lay_grid, list_directions, view_pose
from objconnect.ingestion.virtual.options import ViewOptions
from objconnect.ingestion.virtual.surface import Surface
from objconnect.scene.bundle.covisibility import (
    Covisibility,
    surface_points,
    visible_share,
    write_covisibility,
)
from objconnect.scene.bundle.frames import Frames, Layer, write_frames
from objconnect.scene.bundle.georeference import Georeference
from objconnect.scene.bundle.manifest import Manifest, Objects, Session, Splits, write_json
from objconnect.scene.bundle.scene import COVISIBILITY, finish_scene
from objconnect.scene.errors import InputError
from objconnect.scene.geo.local_coordinates import at_height, world_from
from objconnect.scene.geo.rasters import Grid, Patch, Raster
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic, geodetic_from_enu
from objconnect.scene.quantities.collars import describe_collar
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import atomic_folder
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.images import Exif, write_jpeg
from objconnect.scene.storage.outputs import check_output_folder, require_empty

Array = NDArray[np.float64]

SESSION: Final = "virtual"
_DEFAULTS: Final = ViewOptions()
# Surfaces farther than this many altitudes are not rendered, because texels are blurred there.
_FARTHEST: Final = 4.0
# Views with a smaller share of surface are left out.
_LEAST_SEEN: Final = 0.3
# Rows of a raster that are read at a time.
_ROWS = 256
# Side (px) of the small renders by which views are planned.
_SMALL = 32
# The ground below a view is the mean of this many cells on each side, of a quarter altitude each.
_GROUND_CELLS = 2
_FEWEST = 3


@dataclass(frozen=True)
class VirtualReport:
    """Figures of a scene of virtual photographs.

    Attributes:
        views: number of virtual photographs.
        altitude_m: their height above the ground, metres.
        ground_pixel_m: ground sampling distance of nadir views, metres.
        left_out: number of views that would show too little surface.
        notes: remarks on the input files, a line each.
    """

    views: int
    altitude_m: float
    ground_pixel_m: float
    left_out: int
    notes: tuple[str, ...] = ()

    def text(self) -> str:
        """Return the figures in one line, and the notes."""
        figures = (
            f"{self.views} virtual views from {self.altitude_m:.0f} m above the ground, "
            f"{100 * self.ground_pixel_m:.1f} cm a pixel; {self.left_out} left out at the edges"
        )
        return "\n".join((figures, *self.notes))

    def as_dict(self) -> dict[str, Any]:
        """Return the figures as a dictionary for JSON."""
        return asdict(self)


# More than six parameters: they are options of the command ``map``.
def photograph_orthophoto(
    orthophoto: Path,
    dsm: Path,
    out: Path,
    *,
    undulation: float | None = None,
    options: ViewOptions = _DEFAULTS,
    origin: Geodetic | None = None,
    georeference: Georeference | None = None,
) -> VirtualReport:
    """Render virtual photographs with exact depth from an orthophoto and a surface model.

    The scene has one session, ``virtual``, whose frames are map frames. It has no map yet.

    Args:
        orthophoto: GeoTIFF of 8 bits in any reference system in metres.
        dsm: GeoTIFF of heights; it may have another reference system and resolution.
        out: new or empty folder.
        undulation: height of the geoid above the ellipsoid, metres, for a surface model with
            heights above sea level; 0 means heights above the ellipsoid.
        options: altitude, overlap, tilt and size of the views.
        origin: origin of the world; by default in the middle of the orthophoto, on the ground.
        georeference: accuracy of both files on earth, which the files do not state; None if
            unknown.

    Raises:
        InputError: a raster cannot be used, the rasters do not overlap, too few views show enough
            surface, or ``out`` is not empty or cannot be written.
    """
    rasters = Raster.open(orthophoto, "orthophoto"), Raster.open(dsm, "surface model")
    require_empty(out)
    check_output_folder(out, [orthophoto, dsm])
    survey = _survey(*rasters, undulation or 0.0, options, origin)
    colours, heights = rasters
    place = survey.surface.origin
    collar = [f"{orthophoto.name}: {survey.collar}"] if survey.collar else []
    notes = (*colours.notes(place), *collar, *heights.notes(place, undulation))
    camera = camera_of(options)
    views = _plan_views(survey, camera, options)
    if len(views.poses) < _FEWEST:
        raise InputError(
            f"{len(views.poses)} views of {orthophoto} on {dsm} show enough surface, a map needs "
            f"{_FEWEST}: choose a smaller --altitude"
        )
    config = {
        "orthophoto": {"file": orthophoto.name, "sha256": sha256_of(orthophoto)},
        "dsm": {"file": dsm.name, "sha256": sha256_of(dsm)},
        "undulation": undulation or 0.0,
        "views": options.model_dump(mode="json"),
    }
    with atomic_folder(out) as folder:
        _write(folder, survey, camera, views.poses, _FARTHEST * survey.altitude)
        finish_scene(folder, _manifest(survey.surface.origin, config, georeference))
    return VirtualReport(
        len(views.poses),
        survey.altitude,
        survey.altitude / camera.focal[0],
        views.left_out,
        notes,
    )


@dataclass(frozen=True)
class _Survey:
    """The rasters, and the area that both cover.

    Attributes:
        surface: the rasters and their heights.
        ground: surface model with pixels of a quarter of the altitude; heights above the ellipsoid.
        low: (2,) west and south ends of the area that both rasters cover, world metres.
        high: (2,) east and north ends.
        altitude: height of the views above the ground, metres.
        collar: description of a rim of the orthophoto that may be no data; None without one.
    """

    surface: Surface
    ground: Patch
    low: Array
    high: Array
    altitude: float
    collar: str | None = None

    def above_ground(self, xy: Array) -> Array:
        """Return the point (3,) at the altitude of the views above a ground position (2,)."""
        origin = self.surface.origin
        point = np.array([*xy, 0.0])
        at = geodetic_from_enu(point, origin)
        coordinates = self.ground.grid.projection.from_geodetic(at)
        x, y = self.ground.grid.columns_rows(coordinates[:1], coordinates[1:2])
        rows, columns = (
            slice(max(0, int(c) - _GROUND_CELLS), max(0, int(c) + _GROUND_CELLS + 1))
            for c in (y[0], x[0])
        )
        around = self.ground.values[0, rows, columns]
        around = around[np.isfinite(around)]
        heights = around if around.size else self.ground.values[np.isfinite(self.ground.values)]
        point[2] = float(heights.mean()) + self.altitude - coordinates[2]
        return point


def _survey(
    colours: Raster,
    heights: Raster,
    undulation: float,
    options: ViewOptions,
    origin: Geodetic | None,
) -> _Survey:
    """Read both rasters completely, and compute the area that both cover."""
    collar = describe_collar(_strips(colours))  # reads the whole file: damage is found early
    low, high = np.inf, -np.inf
    for known in _valid_rows(heights):
        low, high = min(low, float(known.min())), max(high, float(known.max()))
    if not np.isfinite(low):
        raise InputError(f"surface model {heights.path} has no height")
    altitude = options.altitude or max(colours.grid.ground_pixel) * camera_of(options).focal[0]
    ground = heights.patch(heights.grid.box, altitude / 4)
    ground = replace(ground, values=ground.values + np.float32(undulation))
    if origin is None:
        box = colours.grid.box
        middle = np.array([(box.left + box.right) / 2, (box.bottom + box.top) / 2, 0.0])
        place = colours.grid.projection.to_geodetic(middle)
        origin = at_height(heights.grid.projection, place, float(np.nanmean(ground.values)))
    ends = [
        _ends(raster.grid, origin, (low + high) / 2 + undulation) for raster in (colours, heights)
    ]
    first = np.max([low_end for low_end, _ in ends], axis=0)
    last = np.min([high_end for _, high_end in ends], axis=0)
    if (first >= last).any():
        raise InputError(f"{colours.path} and {heights.path} do not overlap")
    surface = Surface(colours, heights, undulation, origin, low + undulation, high + undulation)
    return _Survey(surface, ground, first, last, altitude, collar)


def _valid_rows(raster: Raster) -> Iterator[NDArray[np.float32]]:
    """Read a whole raster; yield the valid values of each strip that has some, (N,)."""
    for values in _strips(raster):
        known = values[np.isfinite(values)]
        if known.size:
            yield known


def _strips(raster: Raster) -> Iterator[NDArray[np.float32]]:
    """Read a whole raster; yield the values of strips of rows, (bands, H, W)."""
    with progress_bar(f"read {raster.kind}", raster.grid.height) as advance:
        done = 0
        for strip in raster.strips(_ROWS):
            yield strip.values
            done += strip.grid.height
            advance(done)


def _ends(grid: Grid, origin: Geodetic, height: float) -> tuple[Array, Array]:
    """Return the lower and upper corner, (2,) each, of a grid's bounding box in the world."""
    left, bottom, right, top = grid.box
    corners = [(e, n, height) for e in (left, right) for n in (bottom, top)]
    world = world_from(grid.projection, origin, np.array(corners))[:, :2]
    return world.min(0), world.max(0)


class _Views(NamedTuple):
    """The poses (N, 4, 4) of the views, and the number of views with too little surface."""

    poses: Array
    left_out: int


def _plan_views(survey: _Survey, camera: Camera, options: ViewOptions) -> _Views:
    """Choose the poses (N, 4, 4) of views that show enough surface, by small renders."""
    small = camera.resize(_SMALL, _SMALL)
    farthest = _FARTHEST * survey.altitude
    directions = list_directions(options)
    grid = lay_grid(survey.low, survey.high, survey.altitude, options)
    poses = []
    with progress_bar("plan views", len(grid) * len(directions)) as advance:
        for k, xy in enumerate(grid):
            centre = survey.above_ground(xy)
            for heading, tilt in directions:
                pose = view_pose(centre, heading, tilt)
                if survey.surface.render(small, pose, farthest).coverage >= _LEAST_SEEN:
                    poses.append(pose)
            advance((k + 1) * len(directions))
    return _Views(np.array(poses).reshape(-1, 4, 4), len(grid) * len(directions) - len(poses))


def _write(folder: Path, survey: _Survey, camera: Camera, poses: Array, farthest: float) -> None:
    """Render the views, and write the scene without its manifest."""
    names = tuple(f"{SESSION}/images/{k:06d}.jpg" for k in range(len(poses)))
    points = []

    def views() -> Iterator[dict[Layer, NDArray[Any]]]:
        with progress_bar("virtual views", len(poses)) as advance:
            for k, (name, pose) in enumerate(zip(names, poses, strict=True), 1):
                view = survey.surface.render(camera, pose, farthest)
                centre = -pose[:3, :3].T @ pose[:3, 3]
                exif = Exif(geodetic_from_enu(centre, survey.surface.origin), None)
                write_jpeg(folder / "sessions" / name, view.rgb, exif)
                points.append(surface_points(camera, pose, view.depth))
                advance(k)
                yield {"depth": view.depth}

    unknown = np.full((len(poses), 4), np.nan)
    frames = Frames(
        names=names,
        cameras=(camera,) * len(poses),
        cam_from_world=poses,
        time=unknown[:, 0],
        gps_prior=unknown[:, :3],
        gps_sigma=unknown[:, :3],
        attitude_prior=unknown,
        attitude_sigma_deg=unknown[:, 0],
    )
    write_frames(folder / "sessions" / SESSION / "frames.h5", frames, ["depth"], views())
    write_json(folder / "splits.json", Splits(map=names, queries={}))
    write_json(folder / "objects.json", Objects(classes={}, objects=()))
    shares = visible_share(frames.cameras, poses, np.stack(points))
    write_covisibility(folder / COVISIBILITY, Covisibility(names, shares))


def _manifest(
    origin: Geodetic, config: dict[str, Any], georeference: Georeference | None
) -> Manifest:
    return Manifest(
        versions={n: version(n) for n in ("objconnect", "rasterio", "numpy", "pillow", "h5py")},
        preset=None,
        seed=None,
        config=config,
        origin=origin,
        georeference=georeference,
        sessions={SESSION: Session(condition="orthophoto", flight="virtual", role="map")},
        sha256={},
    )
