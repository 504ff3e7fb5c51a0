"""Output files of ``localize``: poses, a table, GeoJSON, KML, MAVLink logs and ROS 2 bags."""

from __future__ import annotations

import csv
import io
import json
import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.attitude import gimbal_angles
from objconnect.localization.pipeline.accuracy import EarthAccuracy, combine_accuracies
from objconnect.localization.pipeline.cameras import CameraSource
from objconnect.localization.pipeline.mavlink import encode_telemetry_log, import_dialect
from objconnect.localization.pipeline.ros import encode_bag, import_rosbags
from objconnect.localization.pipeline.stamped_pose import StampedPose
from objconnect.scene.bundle.georeference import Georeference
from objconnect.scene.errors import InputError
from objconnect.scene.flights.textfiles import pose_line
from objconnect.scene.geo.crs import Projection
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.localizer import Estimate, Prior, Status
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.storage.names import quote_cell
from objconnect.scene.storage.outputs import OutputFile

# First line of a file of poses. It identifies files of this command, which may be replaced.
_HEADER: Final = "# name qw qx qy qz tx ty tz  (world to camera, metres)"
_POSITION_COLUMNS: Final = ("e", "n", "u", "latitude", "longitude", "altitude")
# First columns of a table. They identify tables of this command, which may be replaced.
_FIRST_COLUMNS: Final = ("name", "status", *_POSITION_COLUMNS, "sigma_m", "inliers", "reason")
_ATTITUDE_COLUMNS: Final = ("yaw_deg", "pitch_deg", "roll_deg")
_COLUMNS: Final = (
    *_FIRST_COLUMNS,
    *("time", "sea_level_m", *_ATTITUDE_COLUMNS, "eph_m", "epv_m"),
    "covariance",
    *("camera", "focal_px", "seconds", "by", "probability"),
)
# Columns of a table with a coordinate reference system.
_CRS_COLUMNS: Final = ("x", "y", "h", "crs", "h_above")
# Text that identifies further files of this command, which may be replaced.
_MARK: Final = "poses by objconnect localize"
_TABLE_SUFFIX: Final = ".csv"
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Geography:
    """The coordinates that are written in addition to WGS84, and the accuracy of the map on earth.

    Attributes:
        undulation_m: height of the geoid above the ellipsoid; None leaves out heights above sea
            level.
        projection: coordinate reference system of the projected coordinates; None for none.
        georeference: accuracy of the map's position on earth; None if unknown.
    """

    undulation_m: float | None = None
    projection: Projection | None = None
    georeference: Georeference | None = None

    def values(self, place: Geodetic) -> dict[str, str | float]:
        """Return height above sea level and projected coordinates of a position, by column."""
        known: dict[str, str | float] = {}
        if self.undulation_m is not None:
            known["sea_level_m"] = round(place.altitude - self.undulation_m, 3)
        if self.projection is not None:
            digits = 8 if self.projection.is_geographic else 4
            x, y, h = self.projection.from_geodetic(place).tolist()
            known |= {"x": round(x, digits), "y": round(y, digits), "h": round(h, 4)}
            known |= {"crs": self.projection.name, "h_above": self.projection.height_reference}
        return known


@dataclass(frozen=True)
class ImageEstimate:
    """A photograph with its estimate.

    Attributes:
        name: name of the photograph.
        estimate: the estimate.
        place: position of the camera on earth; None if unknown.
        time: time at which the photograph was taken; None if unknown.
        camera: camera of the photograph; None if the photograph cannot be read.
        source: source of the camera; None without a camera.
        seconds: time from the start of its sequence; None without a sequence.
        gps: position that a receiver measured, in the map's frame; None without one.
        doubts: metadata of the photograph that are missing, uncertain or were not used.
    """

    name: str
    estimate: Estimate
    place: Geodetic | None
    time: datetime | None = None
    camera: Camera | None = None
    source: CameraSource | None = None
    seconds: float | None = None
    gps: Prior | None = None
    doubts: tuple[str, ...] = ()

    @property
    def reason(self) -> str:
        """Return the reason of the estimate, then the doubts about the metadata."""
        reason = self.estimate.reason
        doubts = (doubt for doubt in self.doubts if doubt not in reason)
        return "; ".join(each for each in (reason, *doubts) if each)

    @property
    def is_localized(self) -> bool:
        """Return whether the photograph was localized; a fallback pose does not count."""
        return self.estimate.status is Status.OK and self.estimate.cam_from_world is not None

    @property
    def centre(self) -> NDArray[np.float64] | None:
        """Return the camera centre (3,) in the map's frame, metres; None without a pose."""
        pose = self.estimate.cam_from_world
        return None if pose is None else np.asarray(pose.centre().numpy())

    @property
    def covariance(self) -> NDArray[np.float64] | None:
        """Return the covariance (6, 6) of centre and attitude, as ``Estimate.world_covariance``."""
        return self.estimate.world_covariance()

    @property
    def sigmas(self) -> tuple[float, float] | None:
        """Return the horizontal and the vertical standard deviation within the map, metres.

        None if they are unknown.
        """
        if self.covariance is None:
            return None
        east, north, up = self.covariance.diagonal()[:3].tolist()
        return math.sqrt(east + north), math.sqrt(up)

    def accuracy(self, geography: Geography) -> EarthAccuracy:
        """Return the accuracy of the position on earth."""
        return combine_accuracies(self.covariance, geography.georeference)

    def to_stamped(self, geography: Geography) -> StampedPose | None:
        """Return the pose with its time, which is taken as UTC.

        None if the photograph was not localized, or if its position on earth or time is unknown.
        """
        pose, centre = self.estimate.cam_from_world, self.centre
        if not self.is_localized or pose is None or centre is None or self.place is None:
            return None
        if self.time is None or (time := self.time.replace(tzinfo=UTC)) < _EPOCH:
            return None
        microseconds = (time - _EPOCH) // timedelta(microseconds=1)
        world_from_cam = pose.rotation.numpy().T
        accuracy = self.accuracy(geography)
        return StampedPose(
            microseconds, self.place, centre, world_from_cam, self.covariance, accuracy
        )

    def values(self, geography: Geography) -> dict[str, str | float]:
        """Return the known values of the table's later columns: time, heights, coordinates,
        attitude, uncertainty, camera and method."""
        known: dict[str, str | float] = {}
        if self.time is not None:
            known["time"] = _stamp(self.time)
        if self.seconds is not None:
            known["seconds"] = round(self.seconds, 6)
        if self.place is not None:
            known |= geography.values(self.place)
        pose = self.estimate.cam_from_world
        if pose is not None:
            angles = gimbal_angles(pose)
            known |= dict(
                zip(_ATTITUDE_COLUMNS, (round(angle, 4) for angle in angles), strict=True)
            )
        accuracy = self.accuracy(geography)
        if accuracy.eph_m is not None:
            known["eph_m"] = round(accuracy.eph_m, 4)
        if accuracy.epv_m is not None:
            known["epv_m"] = round(accuracy.epv_m, 4)
        if self.camera is not None and self.source is not None:
            known["camera"] = self.source.value
            # An estimated focal length is known only if the photograph was localized by points.
            has_points = self.is_localized and self.estimate.inliers > 0
            if has_points or self.source is not CameraSource.ESTIMATED:
                known["focal_px"] = round(self.camera.focal[0], 2)
        if self.estimate.by is not None:
            known["by"] = self.estimate.by.value
        if self.estimate.probability is not None:
            known["probability"] = round(self.estimate.probability, 6)
        return known


def output_files(poses: Path, also: Sequence[Path]) -> list[OutputFile]:
    """Return the files that ``encode_files`` makes: poses, the table beside them, further files.

    Args:
        poses: text file of the poses.
        also: further files, whose endings select the formats; see ``FURTHER_FORMATS``.

    Raises:
        InputError: ``poses`` has no file name or ends in .csv, an ending is unknown, or the package
            that a format needs is not installed.
    """
    if not poses.name:
        raise InputError(f"{poses} is a folder: give a file whose name ends in .txt")
    if poses.suffix.lower() == _TABLE_SUFFIX:
        raise InputError(
            f"{poses} is the name of the table: give the poses a name that ends in .txt"
        )
    for path in also:
        if path.suffix.lower() not in FURTHER_FORMATS:
            raise InputError(f"{path} must end in {' or '.join(FURTHER_FORMATS)}")
        _PACKAGES.get(path.suffix.lower(), lambda: None)()
    table = poses.with_suffix(_TABLE_SUFFIX)
    return [
        OutputFile(poses, _HEADER.encode()),
        OutputFile(table, ",".join(_FIRST_COLUMNS).encode()),
        *(OutputFile(path, _MARK.encode()) for path in also),
    ]


def encode_files(
    estimates: Sequence[ImageEstimate], files: Sequence[OutputFile], geography: Geography
) -> Iterator[tuple[Path, bytes]]:
    """Yield the paths that ``output_files`` returned, with the bytes to write there."""
    poses, table, *also = (file.path for file in files)
    yield poses, _pose_lines(estimates).encode()
    yield table, _table(estimates, geography).encode()
    if any(path.suffix.lower() in _TIMED_FORMATS for path in also):
        _warn_of_missing_times(estimates, geography)
    for path in also:
        yield path, FURTHER_FORMATS[path.suffix.lower()](estimates, geography)


def _pose_lines(estimates: Sequence[ImageEstimate]) -> str:
    lines = [_HEADER]
    for item in estimates:
        pose = item.estimate.cam_from_world
        if item.is_localized and pose is not None:
            lines.append(pose_line(item.name, pose, 9))
    return "\n".join(lines) + "\n"


def _table(estimates: Sequence[ImageEstimate], geography: Geography) -> str:
    text = io.StringIO()
    columns = _COLUMNS if geography.projection is None else (*_COLUMNS, *_CRS_COLUMNS)
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(_row(item, geography) for item in estimates)
    return text.getvalue()


def _row(item: ImageEstimate, geography: Geography) -> Mapping[str, Any]:
    """Return the table's row of a photograph; columns of unknown values are left out."""
    estimate = item.estimate
    row = {"name": quote_cell(item.name), "status": estimate.status.value}
    row |= {"inliers": str(estimate.inliers), "reason": for_terminal(item.reason)}
    if item.centre is not None:
        row |= {axis: f"{x:.4f}" for axis, x in zip("enu", item.centre, strict=True)}
        sigma = estimate.sigma_position()
        row["sigma_m"] = "" if sigma is None else f"{sigma:.4f}"
    if item.place is not None:
        row |= {
            "latitude": f"{item.place.latitude:.8f}",
            "longitude": f"{item.place.longitude:.8f}",
            "altitude": f"{item.place.altitude:.3f}",
        }
    row |= {name: str(value) for name, value in item.values(geography).items()}
    if item.covariance is not None:
        row["covariance"] = " ".join(f"{number:.6g}" for number in item.covariance.ravel())
    return row


def _geojson(estimates: Sequence[ImageEstimate], geography: Geography) -> bytes:
    """Return GeoJSON (RFC 7946): a feature for each photograph, without geometry if not localized.

    Altitudes are above the ellipsoid, as the standard requires.
    """
    features = []
    for item in estimates:
        place = item.place if item.is_localized else None
        values: dict[str, Any] = {"name": for_terminal(item.name)}
        values["status"] = item.estimate.status.value
        if item.reason:
            values["reason"] = for_terminal(item.reason)
        if place is not None:
            sigma = item.estimate.sigma_position()
            values |= {} if sigma is None else {"sigma_m": round(sigma, 4)}
            values |= item.values(geography)
        xyz = None if place is None else [place.longitude, place.latitude, place.altitude]
        geometry = None if xyz is None else {"type": "Point", "coordinates": xyz}
        features.append({"type": "Feature", "geometry": geometry, "properties": values})
    collection = {"type": "FeatureCollection", "generator": _MARK, "features": features}
    return (json.dumps(collection, indent=1, allow_nan=False) + "\n").encode()


def _kml(estimates: Sequence[ImageEstimate], geography: Geography) -> bytes:
    """Return KML 2.2: a placemark for each localized photograph, and the path through them.

    Altitudes are above sea level. If the geoid is unknown, placemarks are clamped to the ground.
    """
    root = ElementTree.Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    document = ElementTree.SubElement(root, "Document")
    ElementTree.SubElement(document, "name").text = _MARK
    undulation_m = geography.undulation_m
    mode = "clampToGround" if undulation_m is None else "absolute"
    found = [item for item in estimates if item.is_localized and item.place is not None]
    for item in found:
        mark = ElementTree.SubElement(document, "Placemark")
        ElementTree.SubElement(mark, "name").text = for_terminal(item.name)
        if item.time is not None:
            stamp = ElementTree.SubElement(mark, "TimeStamp")
            ElementTree.SubElement(stamp, "when").text = f"{_stamp(item.time)}Z"
        _geometry(mark, "Point", [item], mode, undulation_m)
    if len(found) > 1:
        mark = ElementTree.SubElement(document, "Placemark")
        ElementTree.SubElement(mark, "name").text = "path"
        _geometry(mark, "LineString", found, mode, undulation_m)
    ElementTree.indent(root, " ")
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()


def _stamp(time: datetime) -> str:
    """Return a time in ISO 8601, to the millisecond and without time zone."""
    return time.replace(tzinfo=None).isoformat(timespec="milliseconds")


def _geometry(
    mark: ElementTree.Element,
    kind: str,
    estimates: Sequence[ImageEstimate],
    mode: str,
    undulation_m: float | None,
) -> None:
    geometry = ElementTree.SubElement(mark, kind)
    ElementTree.SubElement(geometry, "altitudeMode").text = mode
    places = [item.place for item in estimates if item.place is not None]
    ElementTree.SubElement(geometry, "coordinates").text = " ".join(
        f"{place.longitude:.8f},{place.latitude:.8f},{place.altitude - (undulation_m or 0.0):.3f}"
        for place in places
    )


def _tlog(estimates: Sequence[ImageEstimate], geography: Geography) -> bytes:
    return encode_telemetry_log(_sort_by_time(estimates, geography), geography.undulation_m, _MARK)


def _mcap(estimates: Sequence[ImageEstimate], geography: Geography) -> bytes:
    return encode_bag(_sort_by_time(estimates, geography), _MARK)


def _sort_by_time(estimates: Sequence[ImageEstimate], geography: Geography) -> list[StampedPose]:
    """Return the poses of the localized photographs that have a time, sorted by time."""
    poses = [stamped for item in estimates if (stamped := item.to_stamped(geography)) is not None]
    return sorted(poses, key=lambda stamped: stamped.microseconds)


def _warn_of_missing_times(estimates: Sequence[ImageEstimate], geography: Geography) -> None:
    """Warn of localized photographs without a time, which logs and bags leave out."""
    found = [item for item in estimates if item.is_localized]
    untimed = sum(item.to_stamped(geography) is None for item in found)
    if untimed:
        log.warning(
            "%d of %d photographs have no time and are left out of logs and bags",
            untimed,
            len(found),
        )


FURTHER_FORMATS: Final[Mapping[str, Callable[[Sequence[ImageEstimate], Geography], bytes]]] = {
    ".geojson": _geojson,
    ".kml": _kml,
    ".tlog": _tlog,
    ".mcap": _mcap,
}
"""Formats of further files by their ending."""

# Formats that hold only photographs with a time.
_TIMED_FORMATS: Final = frozenset({".tlog", ".mcap"})
# Functions that raise InputError if the package of a format is not installed.
_PACKAGES: Final[Mapping[str, Callable[[], object]]] = {
    ".tlog": import_dialect,
    ".mcap": import_rosbags,
}
