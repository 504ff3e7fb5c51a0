"""The command ``localize``, which finds the poses of new photographs in a map."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from pydantic import Field

from objconnect.localization.pipeline.answers import Geography, Located, contents, outputs
from objconnect.localization.pipeline.cameras import CameraSource, with_focal_error
from objconnect.localization.pipeline.disagreement import warn_of_disagreement
from objconnect.localization.pipeline.journal import Journal, journal_path
from objconnect.localization.pipeline.photographs import (
    PhotographReader,
    Place,
    QueryPhotograph,
    priors_of,
    warn_of_doubts,
    warn_of_rolling_shutter,
    with_estimates,
)
from objconnect.localization.pipeline.safely import localize_safely
from objconnect.localization.provenance import Environment, Method
from objconnect.scene.bundle.scene import Scene, is_scene
from objconnect.scene.errors import InputError
from objconnect.scene.flights.origin import read_origin
from objconnect.scene.geo.crs import Projection, geoid_undulation
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic, geodetic_from_enu
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import By, Estimate, Localizer, Query, Status, prepare_first
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.answers import Named, PoseNumbers
from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.digests import digest_of, digests_in, sha256_of
from objconnect.scene.storage.listing import PHOTOGRAPHS, list_files
from objconnect.scene.storage.names import quote_name
from objconnect.scene.storage.outputs import check_outputs, check_outside
from objconnect.scene.storage.scratch import cache_or_scratch

log = logging.getLogger(__name__)


def open_place(path: Path) -> Place:
    """Open a scene with its map, or a flight, to localize photographs in it.

    Raises:
        InputError: the path is neither, or its map is missing, damaged or empty.
    """
    if is_scene(path):
        scene = Scene.open(path)
        manifest = scene.manifest
        images = scene.images_root
        return Place(scene.sparse_map(), images, manifest.origin, manifest.on_earth)
    if (path / "sparse" / "map").is_dir():
        return Place(read_model(path / "sparse" / "map"), path / "images", read_origin(path))
    raise InputError(f"{path} is no map: it is neither a scene nor a folder with sparse/map")


# More than six parameters: they are the options of the command ``localize``.
def localize(
    place: Place,
    photographs: Path,
    localizer: Localizer,
    out: Path,
    *,
    camera: Camera | None = None,
    priors: Path | None = None,
    gps_sigma_m: float = 10.0,
    gimbal_sigma_deg: float = 5.0,
    cache: Path | None = None,
    also: Sequence[Path] = (),
    undulation_m: float | None = None,
    projection: Projection | None = None,
) -> list[Located]:
    """Localize every photograph of a folder and write the poses as a text file and a CSV file.

    The text file has a line ``name qw qx qy qz tx ty tz`` (world to camera, metres) for each
    localized photograph. The CSV file beside it has a row for each photograph: status, camera
    centre in the map's frame, latitude, longitude, altitude, sigma and the reason of a failure,
    then time, attitude, camera and covariance (``Located.values``, ``Located.covariance``). A
    photograph that cannot be read fails with that reason. Answers are kept in a
    hidden journal until the end, so that an interrupted run goes on where it stopped.

    Args:
        place: map to localize in.
        photographs: folder of the photographs.
        localizer: method to run.
        out: text file of the poses. It and the CSV file replace only files of this command.
        camera: camera of all photographs; None takes that of each one (``calibration_of``).
        priors: CSV file of positions, and perhaps attitudes (``read_priors``); None takes
            positions from EXIF and attitudes of the gimbal from XMP, where a photograph has them.
        gps_sigma_m: standard deviation of EXIF positions per axis, metres, and of those of a table
            that states none; XMP has that of a fixed position of RTK.
        gimbal_sigma_deg: standard deviation of gimbal attitudes per axis, degrees.
        cache: folder for what the method keeps per map; None for a scratch folder beside ``out``.
        also: further files to write, by their ending: GeoJSON, KML, MAVLink's .tlog, ROS 2's .mcap.
        undulation_m: height of the geoid above the ellipsoid at the place; None takes it from the
            grid of PROJ where that is installed, and else leaves heights above sea level out.
        projection: coordinate reference system in which coordinates are written, too.

    Returns:
        One entry for each photograph.

    Raises:
        InputError: there is no photograph that can be read, the priors cannot be read or name none
            of the photographs, an output cannot be written, lies in their folder or would replace
            a file of another program, or the map of further files has no position on earth.
    """
    paths = {path.name: path for path in photographs_in(photographs)}
    files = outputs(out, also)
    check_outputs(files, [*paths.values(), *([] if priors is None else [priors])])
    check_outside(files, photographs)
    geography = geography_of(place, also, undulation_m, projection)
    sigmas = gps_sigma_m, gimbal_sigma_deg
    known = priors_of(priors, paths, place, *sigmas)
    reader = PhotographReader(place, camera, known, *sigmas, geography.undulation_m)
    _require_one(reader, paths, photographs)
    located: list[Located] = []
    key = journal_key(place.sparse_map, place.images, localizer)
    with (
        Journal(journal_path(out), key, Answer) as journal,
        # The disk of the output has room for what the method keeps per map.
        cache_or_scratch(cache, out.parent) as kept,
    ):
        prepare_first(localizer, place.sparse_map, place.images, kept)
        reader = with_estimates(reader, paths, partial(_localize_twice, reader, localizer))
        with progress_bar(f"localize with {localizer.name}", len(paths)) as advance:
            for name, path in paths.items():
                located.append(_localize_one(reader, localizer, journal, name, path))
                advance(len(located))
        for file, content in contents(located, files, geography):
            with atomic_write(file) as partial_file:
                partial_file.write_bytes(content)
    warn_of_rolling_shutter(reader.said.values())
    warn_of_doubts(reader)
    warn_of_disagreement(located, geography)
    return located


class Answer(Named):
    """The journal's entry of a photograph.

    Attributes:
        name: file name, escaped by ``quote_name`` because JSON cannot hold every
            file name.
        asked: digest of the photograph, its camera and its prior.
        status: status of the estimate.
        reason: reason of the estimate.
        cam_from_world: estimated pose as qw qx qy qz tx ty tz; None without a pose.
        covariance: 36 numbers of the covariance by rows; None if unknown or not finite.
        inliers: number of inliers.
        by: what gave the pose; None if unknown.
        probability: probability that the best pose is right; None if unknown.
    """

    asked: str
    status: Status
    reason: str
    cam_from_world: PoseNumbers | None
    covariance: tuple[float, ...] | None = Field(min_length=36, max_length=36)
    inliers: int
    by: By | None = None
    probability: float | None = None

    @staticmethod
    def of(name: str, asked: str, estimate: Estimate) -> Answer:
        """Return the entry of an estimate."""
        pose, covariance = estimate.cam_from_world, estimate.covariance
        known = covariance is not None and np.isfinite(covariance).all()
        return Answer(
            name=quote_name(name),
            asked=asked,
            status=estimate.status,
            reason=for_terminal(estimate.reason),
            cam_from_world=None
            if pose is None
            else (*pose.quaternion().tolist(), *pose.translation.tolist()),
            covariance=tuple(covariance.ravel().tolist())
            if covariance is not None and known
            else None,
            inliers=estimate.inliers,
            by=estimate.by,
            probability=estimate.probability,
        )

    def estimate(self) -> Estimate:
        """Return the estimate of this entry."""
        numbers, covariance = self.cam_from_world, self.covariance
        return Estimate(
            self.status,
            None if numbers is None else Pose.from_quaternion(numbers[:4], numbers[4:]),
            None if covariance is None else np.reshape(covariance, (6, 6)),
            inliers=self.inliers,
            reason=self.reason,
            by=self.by,
            probability=self.probability,
        )


def photographs_in(folder: Path) -> list[Path]:
    """Return the photographs of a folder, by name.

    Raises:
        InputError: the folder does not exist or holds no photograph.
    """
    if not folder.is_dir():
        wrong = "is not a folder" if folder.exists() else "does not exist"
        raise InputError(f"folder of photographs {folder} {wrong}")
    paths = list_files(folder, PHOTOGRAPHS)
    if not paths:
        raise InputError(f"{folder} holds no photograph ({', '.join(PHOTOGRAPHS)})")
    return paths


def _require_one(reader: PhotographReader, paths: Mapping[str, Path], folder: Path) -> None:
    """Refuse, before any work, a folder without a photograph that can be localized.

    Raises:
        InputError: no photograph can be read and has a camera.
    """
    reason = ""
    for name, path in paths.items():
        try:
            reader(name, path)
            return
        except InputError as error:
            reason = reason or str(error)
    several = f"none of the {len(paths)} photographs in {folder} can be localized: "
    raise InputError((several if len(paths) > 1 else "") + reason)


def _localize_one(
    reader: PhotographReader, localizer: Localizer, journal: Journal[Answer], name: str, path: Path
) -> Located:
    """Localize a photograph, or return the answer that the journal has for it.

    A photograph that is not found with the attitude of its gimbal is tried again without it. A
    photograph that cannot be read is a failure with the reason.
    """
    try:
        photograph = reader.read(name, path)
        asked = _digest(photograph, path)
    except InputError as error:
        return Located(name, Estimate(Status.FAILED, reason=str(error)), None)
    except OSError as error:
        reason = f"cannot read {path}: {error.strerror}"
        return Located(name, Estimate(Status.FAILED, reason=reason), None)
    answer = journal.done.get(quote_name(name))
    if answer is None or answer.asked != asked:
        estimate = _localize_twice(reader, localizer, photograph.query)
        answer = Answer.of(name, asked, estimate)
        journal.add(answer)
    estimate, place = answer.estimate(), reader.place
    camera, source = photograph.query.camera, photograph.calibration.source
    if source is CameraSource.ESTIMATED:
        points = place.sparse_map.xyz
        estimate = with_focal_error(estimate, camera, place.cameras, points)
    at, time = on_earth(estimate, place), photograph.exif.time
    gps, doubts = reader.gps(photograph.exif), reader.doubts(photograph.exif)
    return Located(name, estimate, at, time, camera, source, gps=gps, doubts=doubts)


def _localize_twice(reader: PhotographReader, localizer: Localizer, query: Query) -> Estimate:
    """Localize a query, and where it is not found once more without its gimbal's attitude."""
    estimate = localize_safely(localizer, query)
    if estimate.status is not Status.OK and (other := reader.without_gimbal(query)) is not None:
        second = localize_safely(localizer, other)
        return second if second.status is Status.OK else estimate
    return estimate


def _digest(photograph: QueryPhotograph, path: Path) -> str:
    """Return the digest of a photograph, its camera and its prior."""
    prior = photograph.query.prior
    known = () if prior is None else vars(prior).values()
    return digest_of(sha256_of(path), photograph.query.camera, *known)


def journal_key(sparse_map: SparseMap, images: Path, localizer: Localizer) -> str:
    """Return the digest of everything but the queries that decides the answers."""
    photographs = digests_in(images, sparse_map.names, "missing").values()
    method, environment = Method.of(localizer), Environment.current()
    return digest_of(
        method.model_dump_json(), sparse_map.sha256, *photographs, environment.model_dump_json()
    )


def require_origin(place: Place, asked: Sequence[Path | str]) -> None:
    """Refuse what needs positions on earth where the map has none.

    Args:
        place: the map.
        asked: files or coordinate reference systems.

    Raises:
        InputError: the map has no origin.
    """
    if asked and place.origin is None:
        raise InputError(
            f"{asked[0]} cannot be written, for the map has no position on earth: give a flight "
            "its origin.json (lat, lon, alt)"
        )


def geography_of(
    place: Place,
    also: Sequence[Path],
    undulation_m: float | None,
    projection: Projection | None,
) -> Geography:
    """Return what places are said in beside WGS84.

    Raises:
        InputError: the map has no position on earth and something was asked that needs one, or the
            system does not reach there.
    """
    require_origin(place, [*also, *([] if projection is None else [projection.name])])
    if place.origin is None:
        return Geography(undulation_m)
    if projection is not None and not projection.reaches(place.origin):
        raise InputError(f"the map lies outside {projection.name}: give the system of its zone")
    if projection is not None and (doubt := projection.doubt_at(place.origin)):
        log.warning("%s", doubt)
    if undulation_m is None:
        undulation_m = geoid_undulation(place.origin)
    return Geography(undulation_m, projection, place.georeference)


def on_earth(estimate: Estimate, place: Place) -> Geodetic | None:
    """Return the camera's position on earth; None without a pose or an origin."""
    if estimate.cam_from_world is None or place.origin is None:
        return None
    return geodetic_from_enu(estimate.cam_from_world.centre().numpy(), place.origin)
