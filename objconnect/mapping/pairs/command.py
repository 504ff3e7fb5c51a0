"""The command ``ingest --pair``: make a flight data set from two orthophotos.

The data set has a map, made of the orthophoto of one date, and query photographs with reference
poses, rendered from the other orthophoto.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from pydantic import Field

from objconnect.ingestion.virtual.command import SESSION, VirtualReport, photograph_orthophoto
from objconnect.ingestion.virtual.flight import make_camera
from objconnect.ingestion.virtual.options import ViewOptions
from objconnect.ingestion.virtual.record import SourceFile
from objconnect.ingestion.virtual.survey import Survey, horizontal_bounds, survey_rasters
from objconnect.mapping.build import build_map
from objconnect.mapping.pairs.options import PairQueryOptions
from objconnect.mapping.pairs.photographs import height_range, query_camera, take_photographs
from objconnect.mapping.pairs.rasters import (
    move,
    place_picture,
    read_homography,
    write_level_ground,
)
from objconnect.mapping.pairs.registration import Area, Registration, register
from objconnect.mapping.report import MapReport
from objconnect.scene.bundle.manifest import write_json
from objconnect.scene.errors import InputError
from objconnect.scene.flights.reference_error import REFERENCE_ERROR, ReferencePoseError
from objconnect.scene.flights.textfiles import pose_line
from objconnect.scene.geo.rasters import Raster
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.storage.atomic import atomic_folder, write_text
from objconnect.scene.storage.exif import Exif, write_jpeg
from objconnect.scene.storage.outputs import check_output_folder, require_empty
from objconnect.scene.storage.records import Record
from objconnect.scene.storage.scratch import scratch

PAIR_FILE: Final = "pair.json"
"""Name of the file of a ``PairRecord`` in a flight data set."""

_DEFAULTS: Final = PairQueryOptions()
# Conditions of the map and of the queries, by which results are grouped.
_MAP_DATE: Final = "map-date"
_OTHER_DATE: Final = "other-date"
# Added to the report if the registration is unknown.
_ADVICE: Final = ": compare the two files; if you know the error, give --residual METRES"
# Maximum ratio of the sizes of the orthophotos' pixels on the ground.
_MAX_PIXEL_RATIO: Final = 4.0
# Minimum side of an orthophoto, as a share of the width on the ground of a map photograph.
_MIN_SIDE: Final = 0.7
# Decimals of poses in ``reference_poses.txt``.
_DECIMALS: Final = 9


class PairRecord(Record):
    """How a flight data set was made of two orthophotos, ``pair.json``.

    Attributes:
        schema_version: version of the file format.
        mapped: orthophoto of the map.
        other: orthophoto of the queries.
        dsm: surface model; None for level ground.
        homography: from pixels of ``other`` to pixels of ``mapped``; None if ``other`` is placed by
            its georeference.
        undulation_m: height of the geoid above the ellipsoid, metres.
        options: camera, poses and pictures of the queries.
        moved_m: how far ``other`` was moved to the east and north, metres.
        registration: offset of the orthophotos before the move, and residual after it.
    """

    schema_version: Literal[1] = Field(default=1, alias="schema")
    mapped: SourceFile
    other: SourceFile
    dsm: SourceFile | None
    homography: tuple[tuple[float, float, float], ...] | None
    undulation_m: float
    options: PairQueryOptions
    moved_m: tuple[float, float]
    registration: Registration


@dataclass(frozen=True)
class PairReport:
    """Statistics of a flight data set made of two orthophotos.

    Attributes:
        queries: number of queries.
        heights_m: lowest and highest height of the queries above the ground, metres.
        moved_m: how far the second orthophoto was moved to the east and north, metres.
        registration: offset of the orthophotos before the move, and residual after it.
        error: error of the reference poses.
        virtual: virtual photographs of the map.
        map_report: statistics of the map.
        notes: warnings about the files, a line each.
    """

    queries: int
    heights_m: tuple[float, float]
    moved_m: tuple[float, float]
    registration: Registration
    error: ReferencePoseError
    virtual: VirtualReport
    map_report: MapReport
    notes: tuple[str, ...]

    def text(self) -> str:
        """Return the statistics as lines."""
        low, high = self.heights_m
        lines = [f"{self.queries} queries from {low:.0f} to {high:.0f} m above the ground"]
        if any(self.moved_m):
            east, north = self.moved_m
            move = f"{east:+.2f} m east and {north:+.2f} m north"
            lines.append(f"moved the orthophoto of the queries by {move}")
        advice = _ADVICE if self.error.source == "unknown" else ""
        lines += [self.registration.text() + advice, self.error.text(), *self.notes]
        return "\n".join((*lines, self.virtual.text(), self.map_report.text()))

    def as_dict(self) -> dict[str, Any]:
        """Return the statistics as a dictionary for JSON."""
        return {
            "queries": self.queries,
            "heights_m": self.heights_m,
            "moved_m": self.moved_m,
            "registration": asdict(self.registration),
            "reference_error": self.error.model_dump(),
            "virtual": self.virtual.as_dict(),
            "map": self.map_report.as_dict(),
            "notes": self.notes,
        }


# More than six parameters: they are options of the command ``ingest``.
def ingest_pair(
    mapped: Path,
    other: Path,
    out: Path,
    *,
    homography: Path | None = None,
    dsm: Path | None = None,
    undulation: float | None = None,
    residual: float | None = None,
    options: PairQueryOptions = _DEFAULTS,
) -> PairReport:
    """Make a flight data set: a map of one orthophoto, and queries drawn from another of its site.

    Args:
        mapped: GeoTIFF of the map's date, as ``photograph_orthophoto`` takes it.
        other: GeoTIFF of the date of the queries; with ``homography``, any image file.
        out: new or empty folder of the data set.
        homography: file of the matrix from pixels of ``other`` to pixels of ``mapped``, see
            ``rasters.read_homography``.
        dsm: surface model; None for level ground.
        undulation: height of the geoid above the ellipsoid, metres, for a surface model with
            heights above sea level.
        residual: error of registration that 90 % of the ground does not exceed, metres; None
            measures it.
        options: camera, poses and pictures of the queries.

    Raises:
        InputError: a file cannot be used, the orthophotos do not overlap or their pixels differ too
            much, one has no contrast, too few poses see enough of both, or ``out`` is not empty or
            cannot be written.
    """
    inputs = [path for path in (mapped, other, homography, dsm) if path is not None]
    if dsm is None and undulation is not None:
        raise InputError("the undulation belongs to a surface model: give --dsm too")
    first = Raster.open(mapped, "orthophoto")
    matrix = None if homography is None else read_homography(homography)
    require_empty(out)
    check_output_folder(out, inputs)
    with scratch(out.resolve().parent) as work:
        placed = other
        if matrix is not None:
            placed = work / "other.tif"
            place_picture(other, matrix, first, placed)
        ground = dsm
        if ground is None:
            ground = work / "ground.tif"
            write_level_ground(first, ground)
        second = Raster.open(placed, "orthophoto")
        _check_scale(first, second, (mapped, other))
        pair = _survey_pair(first, second, Raster.open(ground, "surface model"), undulation, other)
        moved, registration, pair = _align(pair, (mapped, other))
        error = _reference_error(registration, residual)
        record = PairRecord(
            mapped=SourceFile.of(mapped),
            other=SourceFile.of(other),
            dsm=None if dsm is None else SourceFile.of(dsm),
            homography=None if matrix is None else tuple(tuple(row) for row in matrix.tolist()),
            undulation_m=undulation or 0.0,
            options=options,
            moved_m=moved,
            registration=registration,
        )
        with atomic_folder(out) as folder:
            _write_queries(folder, pair, options)
            origin = pair.mapped.surface.origin
            virtual, report = _write_map(folder, work, mapped, ground, undulation, origin)
            _write_conditions(folder, options.queries)
            write_json(folder / REFERENCE_ERROR, error)
            write_json(folder / PAIR_FILE, record)
    level = () if dsm is not None else ("no surface model: the ground is taken as level",)
    notes = (*second.notes(pair.mapped.surface.origin), *level)
    heights = height_range(options, max(second.grid.ground_pixel))
    return PairReport(options.queries, heights, moved, registration, error, virtual, report, notes)


class _Pair(NamedTuple):
    """The orthophotos of both dates in one world, on one surface model, and their common ground."""

    mapped: Survey
    other: Survey
    area: Area


def _check_scale(first: Raster, second: Raster, paths: tuple[Path, Path]) -> None:
    sizes = [max(raster.grid.ground_pixel) for raster in (first, second)]
    if max(sizes) > _MAX_PIXEL_RATIO * min(sizes):
        raise InputError(
            f"a pixel is {sizes[0]:.3g} m in {paths[0]} and {sizes[1]:.3g} m in {paths[1]}: they "
            f"may differ by a factor of {_MAX_PIXEL_RATIO:g} at most; resample the finer one"
        )


def _survey_pair(
    first: Raster, second: Raster, heights: Raster, undulation: float | None, other: Path
) -> _Pair:
    """Read all rasters, and compute the ground that they share."""
    mapped = survey_rasters(first, heights, undulation or 0.0, ViewOptions(), None)
    _require_large(first, mapped)
    origin = mapped.surface.origin
    low, high = horizontal_bounds(second.grid, origin, origin.altitude)
    area = Area(np.maximum(low, mapped.low), np.minimum(high, mapped.high))
    if (area.low >= area.high).any():
        raise InputError(f"{first.path} and {other} do not overlap")
    other_survey = survey_rasters(second, heights, undulation or 0.0, ViewOptions(), origin)
    return _Pair(mapped, other_survey, area)


def _require_large(orthophoto: Raster, survey: Survey) -> None:
    """Refuse an orthophoto that is too small for the photographs of a map."""
    camera = make_camera(ViewOptions())
    needed = _MIN_SIDE * survey.altitude * camera.width / camera.focal[0]
    east, north = (survey.high - survey.low).tolist()
    if min(east, north) < needed:
        raise InputError(
            f"{orthophoto.path} covers {east:.0f} x {north:.0f} m, a map needs {needed:.0f} x "
            f"{needed:.0f} m with pixels of this size: give a larger part of it"
        )


def _align(
    pair: _Pair, files: tuple[Path, Path]
) -> tuple[tuple[float, float], Registration, _Pair]:
    """Move the second orthophoto by the median offset.

    Returns:
        The move to the east and north (m), the registration before it, and the pair after it.
    """
    first, second = (each.surface.colours for each in (pair.mapped, pair.other))
    origin = pair.mapped.surface.origin
    registration = register(first, second, pair.area, origin, files)
    if registration.offset_m is None:
        return (0.0, 0.0), registration, pair
    east, north = registration.offset_m
    second = move(second, np.array([-east, -north]), origin)
    surface = replace(pair.other.surface, colours=second)
    pair = pair._replace(other=replace(pair.other, surface=surface))
    return (-east, -north), registration, pair


def _reference_error(registration: Registration, residual: float | None) -> ReferencePoseError:
    if residual is not None:
        return ReferencePoseError(metres=residual, source="stated")
    if registration.largest_m is None:
        return ReferencePoseError(metres=None, source="unknown")
    return ReferencePoseError(metres=registration.largest_m, source="measured")


def _query_name(number: int) -> str:
    return f"q{number:04d}.jpg"


def _write_queries(folder: Path, pair: _Pair, options: PairQueryOptions) -> None:
    """Write the queries, their camera and their poses."""
    camera, cameras, poses = query_camera(options), [], []
    photographs = take_photographs(pair.other, pair.mapped, pair.area, options)
    exif = Exif(None, None, model="virtual camera")
    for k, photograph in enumerate(photographs):
        name = _query_name(k)
        write_jpeg(folder / "images" / name, photograph.rgb, exif, options.jpeg_quality)
        cameras.append(f"{name} {camera}\n")
        poses.append(f"{pose_line(name, photograph.cam_from_world, _DECIMALS)}\n")
    write_text(folder / "queries.txt", "".join(cameras))
    write_text(folder / "reference_poses.txt", "".join(poses))


def _write_map(
    folder: Path,
    work: Path,
    mapped: Path,
    ground: Path,
    undulation: float | None,
    origin: Geodetic,
) -> tuple[VirtualReport, MapReport]:
    """Write the map, its photographs and the origin."""
    scene = work / "scene"
    virtual = photograph_orthophoto(mapped, ground, scene, undulation=undulation, origin=origin)
    report = build_map(scene)
    model = folder / "sparse" / "map"
    model.mkdir(parents=True)
    for file in sorted((scene / "map").glob("*.bin")):
        shutil.copyfile(file, model / file.name)
    shutil.copytree(scene / "sessions" / SESSION / "images", folder / "images" / SESSION / "images")
    place = {"lat": origin.latitude, "lon": origin.longitude, "alt": origin.altitude}
    write_text(folder / "origin.json", json.dumps(place) + "\n")
    return virtual, report


def _write_conditions(folder: Path, queries: int) -> None:
    """Write the condition of each photograph of the map and of each query."""
    images = folder / "images"
    mapped = sorted(path.relative_to(images).as_posix() for path in images.glob("*/*/*.jpg"))
    dates = dict.fromkeys(mapped, _MAP_DATE)
    dates |= dict.fromkeys(map(_query_name, range(queries)), _OTHER_DATE)
    rows = (f"{name},{date}\n" for name, date in dates.items())
    write_text(folder / "conditions.csv", "".join(("name,condition\n", *rows)))
