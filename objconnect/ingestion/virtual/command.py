"""Make a scene from an orthophoto: virtual photographs with exact poses and depth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.virtual.flight import lay_grid, list_directions, make_camera, view_pose
from objconnect.ingestion.virtual.options import ViewOptions
from objconnect.ingestion.virtual.record import (
    SourceFile,
    ViewsRecord,
    find_finished,
    open_unfinished,
)
from objconnect.ingestion.virtual.survey import MAX_DEPTH_ALTITUDES, Survey, survey_rasters
from objconnect.scene.bundle.covisibility import (
    Covisibility,
    surface_points,
    visible_share,
    write_covisibility,
)
from objconnect.scene.bundle.frames import Frames, Layer, write_frames
from objconnect.scene.bundle.georeference import Georeference
from objconnect.scene.bundle.manifest import Manifest, Objects, Session, Splits, write_json
from objconnect.scene.bundle.scene import COVISIBILITY, MANIFEST, Scene, finish_scene
from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.geo.rasters import Raster
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic, geodetic_from_enu
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import remove_owned
from objconnect.scene.storage.exif import Exif, write_jpeg
from objconnect.scene.storage.locks import write_lock
from objconnect.scene.storage.outputs import check_output_folder

Array = NDArray[np.float64]

SESSION: Final = "virtual"
"""Name of the session (flight) of virtual photographs."""

_FRAMES: Final = f"{SESSION}/frames.h5"

_DEFAULTS: Final = ViewOptions()
# Views in which a smaller share of the pixels shows the surface are left out.
_MIN_COVERAGE: Final = 0.3
# Side (px) of the previews whose share of surface decides which views are rendered.
_PREVIEW_SIDE = 32
# Minimum number of views of a map.
_MIN_VIEWS = 3


@dataclass(frozen=True)
class VirtualReport:
    """Statistics of a scene of virtual photographs.

    Attributes:
        views: number of virtual photographs.
        altitude_m: their height above the ground, metres.
        ground_pixel_m: ground sampling distance of nadir views, metres.
        left_out: number of views that would show too little surface.
        notes: warnings about the input files, a line each.
    """

    views: int
    altitude_m: float
    ground_pixel_m: float
    left_out: int
    notes: tuple[str, ...] = ()

    def text(self) -> str:
        """Return the statistics in one line, and the notes."""
        figures = (
            f"{self.views} virtual views from {self.altitude_m:.0f} m above the ground, "
            f"{100 * self.ground_pixel_m:.1f} cm a pixel; {self.left_out} left out at the edges"
        )
        return "\n".join((figures, *self.notes))

    def as_dict(self) -> dict[str, Any]:
        """Return the statistics as a dictionary for JSON."""
        return asdict(self)


class RecordedHeights(NamedTuple):
    """The surface model that a scene was made from.

    Attributes:
        file: name of the file.
        undulation_m: height of the geoid that was added to its heights, metres.
    """

    file: str
    undulation_m: float


def read_recorded_heights(scene: Scene) -> RecordedHeights:
    """Return the surface model that ``photograph_orthophoto`` recorded in ``scene.json``.

    Raises:
        InputError: the scene was not made from an orthophoto.
    """
    dsm, undulation = (scene.manifest.config.get(key) for key in ("dsm", "undulation"))
    if not isinstance(dsm, dict) or not isinstance(undulation, int | float):
        raise InputError(
            f"scene {scene.path} was not made from an orthophoto: make it with 'objconnect map "
            "--ortho'"
        )
    return RecordedHeights(str(dsm.get("file")), float(undulation))


@dataclass(frozen=True)
class ViewSource:
    """The files that virtual views are rendered from, and how.

    Attributes:
        colours: orthophoto.
        heights: surface model.
        undulation: height of the geoid above the ellipsoid, metres; None if it is not stated.
        record: inputs and options.
    """

    colours: Raster
    heights: Raster
    undulation: float | None
    record: ViewsRecord


# More than six parameters: they are options of the command ``map``.
def open_source(
    orthophoto: Path,
    dsm: Path,
    undulation: float | None,
    options: ViewOptions,
    origin: Geodetic | None,
    georeference: Georeference | None,
    method: str | None = None,
) -> ViewSource:
    """Open the files of ``photograph_orthophoto``, which explains the arguments.

    Args:
        method: method that builds the map after the views; None without a map.

    Raises:
        InputError: a file cannot be used.
    """
    colours, heights = Raster.open(orthophoto, "orthophoto"), Raster.open(dsm, "surface model")
    record = ViewsRecord(
        orthophoto=SourceFile.of(orthophoto),
        dsm=SourceFile.of(dsm),
        undulation=undulation or 0.0,
        views=options,
        origin=origin,
        georeference=georeference,
        method=method,
    )
    return ViewSource(colours, heights, undulation, record)


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
    """Render virtual photographs with exact depth, or continue an interrupted run.

    The scene has one session, ``virtual``, whose frames are all meant for the map. It has no map
    yet.

    Args:
        orthophoto: GeoTIFF of 8 bits in any reference system in metres.
        dsm: GeoTIFF of heights; it may have another reference system and resolution.
        out: new folder, or one left by a run of the same files and options.
        undulation: height of the geoid above the ellipsoid, metres, for a surface model with
            heights above sea level; 0 means heights above the ellipsoid. None is taken as 0, and
            a note says so if the file does not state the vertical datum.
        options: altitude, overlap, tilt and size of the views.
        origin: origin of the world; by default in the middle of the orthophoto, at the
            mean height of the surface model.
        georeference: absolute (geodetic) accuracy of both files, which they do not state; None
            if unknown.

    Raises:
        InputError: a raster cannot be used, the rasters do not overlap, too few views show enough
            surface, or ``out`` holds other files, cannot be written or is being written by another
            run.
    """
    source = open_source(orthophoto, dsm, undulation, options, origin, georeference)
    check_output_folder(out, [orthophoto, dsm])
    with write_lock(out):
        return render_views(source, out)


def render_views(source: ViewSource, out: Path) -> VirtualReport:
    """Render the views of a source, unless ``out`` holds them already.

    The caller holds the lock of ``out``. If a file cannot be used, what was written is removed.

    Raises:
        InputError: for the reasons of ``photograph_orthophoto``.
    """
    record, colours, heights = source.record, source.colours, source.heights
    finished = find_finished(out, record)
    survey = survey_rasters(colours, heights, record.undulation, record.views, record.origin)
    origin = survey.surface.origin
    collar = [f"{colours.path.name}: {survey.collar}"] if survey.collar else []
    notes = (*colours.notes(origin), *collar, *heights.notes(origin, source.undulation))
    camera = make_camera(record.views)
    views = _plan_views(survey, camera, record.views)
    if len(views.poses) < _MIN_VIEWS:
        raise InputError(
            f"{len(views.poses)} views of {colours.path} on {heights.path} show enough surface, a "
            f"map needs {_MIN_VIEWS}: choose a smaller --altitude"
        )
    if finished is None:
        unfinished = open_unfinished(out, record)
        unfinished.begin()
        try:
            _write(out, survey, camera, views.poses)
        except WriteError:
            raise  # a later run continues when the disk has room
        except InputError:
            remove_views(out, len(views.poses))
            raise
        finish_scene(out, _manifest(origin, record))
        unfinished.end()
    return VirtualReport(
        len(views.poses),
        survey.altitude,
        survey.altitude / camera.focal[0],
        views.left_out,
        notes,
    )


def remove_views(out: Path, views: int) -> None:
    """Remove the scene of a number of views from which no map can be built."""
    lists = ("splits.json", "objects.json", COVISIBILITY, MANIFEST, f"sessions/{_FRAMES}")
    remove_owned(out, {*lists, *(f"sessions/{name}" for name in _names(views))})


class _Views(NamedTuple):
    """The poses (N, 4, 4) of the views, and the number of views with too little surface."""

    poses: Array
    left_out: int


def _plan_views(survey: Survey, camera: Camera, options: ViewOptions) -> _Views:
    """Choose the poses (N, 4, 4) of views that show enough surface in a small preview."""
    preview_camera = camera.resize(_PREVIEW_SIDE, _PREVIEW_SIDE)
    farthest = MAX_DEPTH_ALTITUDES * survey.altitude
    directions = list_directions(options)
    grid = lay_grid(survey.low, survey.high, survey.altitude, options)
    poses = []
    with progress_bar("plan views", len(grid) * len(directions)) as advance:
        for k, xy in enumerate(grid):
            centre = survey.above_ground(xy)
            for heading, tilt in directions:
                pose = view_pose(centre, heading, tilt)
                if survey.surface.render(preview_camera, pose, farthest).coverage >= _MIN_COVERAGE:
                    poses.append(pose)
            advance((k + 1) * len(directions))
    return _Views(np.array(poses).reshape(-1, 4, 4), len(grid) * len(directions) - len(poses))


def _names(views: int) -> tuple[str, ...]:
    return tuple(f"{SESSION}/images/{k:06d}.jpg" for k in range(views))


def _write(folder: Path, survey: Survey, camera: Camera, poses: Array) -> None:
    """Render the views, and write the scene without its manifest."""
    names, points = _names(len(poses)), []
    farthest = MAX_DEPTH_ALTITUDES * survey.altitude

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
    write_frames(folder / "sessions" / _FRAMES, frames, ["depth"], views())
    write_json(folder / "splits.json", Splits(map=names, queries={}))
    write_json(folder / "objects.json", Objects(classes={}, objects=()))
    shares = visible_share(frames.cameras, poses, np.stack(points))
    write_covisibility(folder / COVISIBILITY, Covisibility(names, shares))


def _manifest(origin: Geodetic, record: ViewsRecord) -> Manifest:
    return Manifest(
        versions={n: version(n) for n in ("objconnect", "rasterio", "numpy", "pillow", "h5py")},
        preset=None,
        seed=None,
        config=record.model_dump(mode="json"),
        origin=origin,
        georeference=record.georeference,
        sessions={SESSION: Session(condition="orthophoto", flight="virtual", role="map")},
        sha256={},
    )
