"""The report of ``ingest``: statistics of a scene made from photographs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from objconnect.ingestion.adjustment import AdjustedModel
from objconnect.ingestion.control import ControlResidual, control_text
from objconnect.ingestion.photographs import Flight
from objconnect.scene.bundle.georeference import Georeference
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.photographs import Photograph
from objconnect.scene.maps.sparse_map import SparseMap

REPORT = Path("ingest.json")
"""The report, in the folder of its scene."""

# Maximum number of lines in the text for each kind of reason.
_MAX_LINES = 6
# A median distance of GPS from the cameras above this (m) is reported as a contradiction.
_FAR_FROM_GPS_M = 30.0


class Residuals(BaseModel):
    """Statistics of the absolute distances between cameras and their GPS fixes, metres.

    Vertical values cover the fixes with an altitude; they are None if no fix has one.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    horizontal_median: float
    horizontal_rms: float
    vertical_median: float | None
    vertical_rms: float | None

    def text(self) -> str:
        """Return the statistics as text."""
        horizontal = f"{self.horizontal_median:.2f} m median, {self.horizontal_rms:.2f} m rms"
        if self.vertical_median is None or self.vertical_rms is None:
            return f"horizontal {horizontal}; vertical unknown"
        vertical = f"{self.vertical_median:.2f} m median, {self.vertical_rms:.2f} m rms"
        return f"horizontal {horizontal}; vertical {vertical}"


class Lens(BaseModel):
    """A lens: number of photographs, camera, and the source of the camera's parameters."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    photographs: int
    camera: str
    origin: str


class IngestReport(BaseModel):
    """Statistics of an ingested flight.

    Attributes:
        photographs: number of JPEGs in the folder.
        left_out: reasons why files are not in the scene, by file.
        registered: number of photographs in the scene.
        points: number of points in the model of all photographs of the scene.
        track_length: mean number of photographs that observe a point.
        reprojection_error_px: mean reprojection error over all observations, pixels.
        level: what defines the vertical: "gps", the "ground", poses that were "given", points of
            "control", or the "map" that photographs were added to.
        fixes: number of photographs whose GPS position was used.
        blunders: distance of each rejected fix from its camera, metres, by file.
        wrong_attitudes: angle between each rejected gimbal attitude and its camera, degrees, by
            file.
        turned: files that had been rotated by 180 degrees; the scene rotates them back.
        gps: residuals of the fixes that were used, with their delay; None without any.
        lag_s: delay of the fixes behind their photographs, seconds; 0 where none was estimated.
        gps_without_lag: residuals of the fixes after this delay is removed; None without a delay.
        map_images: number of map photographs.
        map_points: number of points of the map, triangulated from the map photographs alone.
        control: ground control points, in the order of their list.
        kept: number of frames of the existing scene, if photographs were added to one; else 0. The
            values of points, map and queries then cover the whole scene, the others the new
            photographs.
        georeference: accuracy of the scene's position on earth; None if unknown.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    photographs: int
    left_out: dict[str, str]
    registered: int
    points: int
    track_length: float
    reprojection_error_px: float
    lenses: tuple[Lens, ...]
    level: str
    fixes: int
    blunders: dict[str, float]
    wrong_attitudes: dict[str, float]
    turned: tuple[str, ...]
    gps: Residuals | None
    lag_s: float
    gps_without_lag: Residuals | None
    map_images: int
    map_points: int
    queries: int
    control: tuple[ControlResidual, ...] = ()
    kept: int = 0
    georeference: Georeference | None = None

    def text(self) -> str:
        """Return the report as text."""
        vertical_sources = {
            "gps": "vertical from GPS",
            "ground": "vertical from the ground (GPS altitudes unusable, or a straight flight)",
            "given": "poses as imported",
            "control": "vertical from ground control points",
            "map": "world of the existing scene",
        }
        gps = "none" if self.gps is None else self.gps.text()
        new = f"new photographs registered in a scene of {self.kept}" if self.kept else ""
        lines = [
            f"{self.registered} of {self.photographs} {new or 'photographs registered'}, "
            f"{self.points} points in tracks of {self.track_length:.1f}, "
            f"{self.reprojection_error_px:.2f} px mean reprojection error",
            f"GPS residuals of {self.fixes} photographs: {gps}; {vertical_sources[self.level]}",
            *gps_remark(self.level, self.gps),
            *(
                [f"GPS delay {self.lag_s:.1f} s; without it: {self.gps_without_lag.text()}"]
                if self.gps_without_lag is not None
                else []
            ),
            f"map of {self.map_images} photographs and {self.map_points} points, "
            f"{self.queries} queries",
            *control_text(self.control),
            "position on earth: "
            + ("unknown" if self.georeference is None else self.georeference.text()),
            *(f"lens {x.name}: {x.photographs} photographs, {x.origin}" for x in self.lenses),
            *_list_reasons("wrong GPS", {k: f"{v:.0f} m off" for k, v in self.blunders.items()}),
            *_list_reasons(
                "wrong attitude", {k: f"{v:.0f}° off" for k, v in self.wrong_attitudes.items()}
            ),
            *_list_reasons(
                "rotated back", dict.fromkeys(self.turned, "by 180°, according to its gimbal")
            ),
            *_list_reasons("left out", self.left_out),
        ]
        return "\n".join(lines)


def gps_remark(level: str, gps: Residuals | None) -> list[str]:
    """Return a warning where GPS contradicts the ground control points or the imported poses."""
    if gps is None or level not in ("control", "given"):
        return []
    medians = {"horizontally": gps.horizontal_median, "in height": gps.vertical_median}
    far = [
        f"{metres:.0f} m {axis}"
        for axis, metres in medians.items()
        if metres is not None and metres > _FAR_FROM_GPS_M
    ]
    if not far:
        return []
    source = "ground control points" if level == "control" else "the imported poses"
    return [
        f"GPS contradicts {source} by {' and '.join(far)}: check the coordinate system, the unit "
        "of heights (feet?) and their datum (ellipsoid or sea level)"
    ]


def _list_reasons(what: str, reasons: Mapping[str, str]) -> list[str]:
    lines = [f"{what}: {name}: {reason}" for name, reason in list(reasons.items())[:_MAX_LINES]]
    more = len(reasons) - len(lines)
    return [*lines, f"{what}: {more} more, all in ingest.json"] if more > 0 else lines


def residuals(
    model: SparseMap, fixes: Mapping[str, NDArray[np.float64]], names: Sequence[str]
) -> NDArray[np.float64]:
    """Return fixes minus camera centres of photographs, (N, 3) metres; up may be NaN."""
    differences = [fixes[name] - model.images[name].centre for name in names]
    return np.array(differences).reshape(-1, 3)


def summarise(differences: NDArray[np.float64]) -> Residuals:
    """Return statistics of fixes minus camera centres, (N, 3) metres."""
    horizontal = np.linalg.norm(differences[:, :2], axis=1)
    vertical = np.abs(differences[np.isfinite(differences[:, 2]), 2])
    return Residuals(
        horizontal_median=float(np.median(horizontal)),
        horizontal_rms=float(np.sqrt((horizontal**2).mean())),
        vertical_median=float(np.median(vertical)) if len(vertical) else None,
        vertical_rms=float(np.sqrt((vertical**2).mean())) if len(vertical) else None,
    )


def describe_lenses(photographs: Sequence[Photograph], adjusted: AdjustedModel) -> tuple[Lens, ...]:
    """Return the cameras of a model by lens, in the order of the photographs."""
    images = adjusted.model.images
    by_lens: dict[str, list[Photograph]] = {}
    for photograph in photographs:
        if photograph.name in images:
            by_lens.setdefault(photograph.lens, []).append(photograph)
    return tuple(
        Lens(
            name=lens,
            photographs=len(group),
            camera=str(images[group[0].name].camera),
            origin=_describe_origin(
                group[0], images[group[0].name].camera, lens in adjusted.refined.focal
            ),
        )
        for lens, group in by_lens.items()
    )


def _describe_origin(first: Photograph, camera: Camera, refined: bool) -> str:
    """Describe the source of a camera's parameters, given a photograph before the adjustment."""
    start, focal = first.camera.focal[0], camera.focal[0]
    if first.calibrated:
        return f"focal length {focal:.1f} px as given"
    x, y = np.subtract(camera.principal, (camera.width / 2, camera.height / 2))
    principal = f"; principal point refined, {x:+.1f}, {y:+.1f} px off the middle" if x or y else ""
    if not first.focal_known:
        return (
            f"{first.focal_doubt or 'no focal length in EXIF'}: "
            f"guessed {start:.1f} px, refined to {focal:.1f} px "
            f"(over flat ground, give --camera){principal}"
        )
    if refined:
        return f"focal length {start:.1f} px of EXIF refined to {focal:.1f} px{principal}"
    reason = "it is not refined over flat ground or in an existing map"
    return f"focal length {focal:.1f} px of EXIF kept: {reason}{principal}"


@dataclass(frozen=True)
class Findings:
    """Results of checking gimbals, ground control points and fixes.

    Attributes:
        wrong_attitudes: errors of rejected attitudes, degrees, by file.
        rotated: files that had been rotated by 180 degrees.
        control: residuals of ground control points.
        georeference: accuracy of the scene's position on earth; None if unknown.
    """

    wrong_attitudes: Mapping[str, float]
    rotated: Sequence[str]
    control: tuple[ControlResidual, ...] = ()
    georeference: Georeference | None = None


def make_report(
    photographs: Sequence[Photograph],
    flight: Flight,
    adjusted: AdjustedModel,
    fixes: Mapping[str, NDArray[np.float64]],
    sparse_map: SparseMap,
    findings: Findings,
) -> IngestReport:
    """Make the report of an ingested flight.

    Args:
        photographs: photographs that structure from motion received.
        flight: photographs of the model, and the files that were left out with reasons.
        adjusted: the model of map photographs and queries, in world metres.
        fixes: measured positions by name, world metres.
        sparse_map: the map, triangulated from the map photographs.
        findings: results of checking gimbals, ground control points and fixes.
    """
    model, georegistration = adjusted.model, adjusted.georegistration
    files = {image.name: image.file for image in flight.images}
    used = [n for n in model.names if n in fixes and n not in georegistration.blunders]
    wrong = residuals(model, fixes, georegistration.blunders)
    return IngestReport(
        photographs=len(flight.images) + len(flight.left_out),
        left_out=dict(flight.left_out),
        registered=len(model.images),
        points=len(model.xyz),
        track_length=float(model.track_length.mean()),
        reprojection_error_px=model.reprojection_error(),
        lenses=describe_lenses(photographs, adjusted),
        level=georegistration.level,
        fixes=len(used),
        blunders={
            files[name]: float(np.linalg.norm(np.nan_to_num(difference)))
            for name, difference in zip(georegistration.blunders, wrong, strict=True)
        },
        wrong_attitudes=dict(findings.wrong_attitudes),
        turned=tuple(findings.rotated),
        gps=summarise(residuals(model, fixes, used)) if used else None,
        lag_s=adjusted.delay,
        gps_without_lag=(
            summarise(
                residuals(
                    model,
                    adjusted.undelayed_fixes,
                    [n for n in used if n in adjusted.undelayed_fixes],
                )
            )
            if adjusted.undelayed_fixes
            else None
        ),
        map_images=len(sparse_map.images),
        map_points=len(sparse_map.xyz),
        queries=len(model.images) - len(sparse_map.images),
        control=findings.control,
        georeference=findings.georeference,
    )
