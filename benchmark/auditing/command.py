"""The command ``audit``, which checks a data set's poses and cameras against its photographs."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.auditing.agreement import (
    CHECK,
    RIGHT_SHARE,
    Rays,
    check_poses,
    mean_agreement,
    rays_of,
)
from benchmark.auditing.calibration import (
    Correction,
    check_calibration,
    correct_camera,
    fit_correction,
)
from benchmark.auditing.files import Photographs, check_files, fit_cameras, read_photographs
from benchmark.auditing.findings import Audit, Finding, Verdict, unknown
from benchmark.auditing.map_points import check_points
from benchmark.auditing.matches import match_photographs
from benchmark.auditing.opening import open_data
from benchmark.auditing.page import check_page, write_page
from benchmark.auditing.photograph_order import find_order
from benchmark.auditing.positions import ALIGNED, check_positions
from benchmark.auditing.statements import StatedData, centres, sample
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.imports.poses import CoordinateFrame
from objconnect.scene.quantities.doubts import summarize_doubts

Array = NDArray[np.float64]

log = logging.getLogger(__name__)

# Number of photographs to match with each other, and length of the runs of neighbours among them.
_MAX_MATCHED, _RUN_LENGTH = 32, 8


def audit(
    path: Path,
    images: Path | None = None,
    camera: Camera | None = None,
    out: Path | None = None,
    frame: CoordinateFrame | None = None,
) -> list[Audit]:
    """Audit a data set, or each data set of a folder that holds several.

    Args:
        path: a scene, a flight, or poses of another program; see ``opening.open_data``.
        images: folder of the photographs; None searches the usual folders of the format.
        camera: camera of the photographs if the data set states none.
        out: HTML file for the verdicts; None writes none.
        frame: frame of another program's poses, if their file does not state it.

    Raises:
        InputError: as for ``opening.open_data``, or the page cannot be written.
    """
    if out is not None:
        check_page(out, [path, *([images] if images is not None else [])])
    audits = [_audit_one(stated) for stated in open_data(path, images, camera, frame)]
    if out is not None:
        write_page(audits, out)
    return audits


def _audit_one(stated: StatedData) -> Audit:
    photographs = read_photographs(stated)
    tags = zip(stated.names, photographs.exif, strict=True)
    for line in summarize_doubts({name: exif.doubts for name, exif in tags if exif is not None}):
        log.warning("%s", line)
    findings = list(check_files(stated, photographs))
    positions, names_confirmed, xy_pairs = stated.positions, False, np.zeros((0, 4))
    if stated.cam_from_world is not None:
        geometry, positions = _check_geometry(stated, photographs)
        names_confirmed = any(f.check == CHECK and f.verdict is Verdict.RIGHT for f in geometry)
        findings += geometry
    if positions is None and stated.cam_from_world is not None:
        why = "not compared: it is unknown which position belongs to which photograph"
        findings.append(unknown(ALIGNED, why))
    else:
        position_findings, xy_pairs = check_positions(
            stated, positions, photographs.exif, names_confirmed
        )
        findings += position_findings
    rows = tuple(tuple(row) for row in xy_pairs.tolist())
    return Audit(stated.subject, stated.kind, len(stated), tuple(findings), rows)


def _check_geometry(
    stated: StatedData, photographs: Photographs
) -> tuple[list[Finding], Array | None]:
    """Check poses, cameras and points, and return the camera centres in the right convention.

    The centres are None if it is unknown which photograph they belong to.
    """
    assert stated.cam_from_world is not None
    poses = stated.cam_from_world
    cameras = fit_cameras(stated, photographs)
    if stated.files is None:
        findings = [unknown(CHECK, "there are no photographs to compare with")]
        fitted = None
    elif all(camera is None for camera in cameras):
        why = "the data set states no camera, and EXIF states no focal length: give --camera"
        findings, fitted = [unknown(CHECK, why)], None
    else:
        duplicates = photographs.duplicates
        rows = [
            row for row in sample(len(stated), _MAX_MATCHED, _RUN_LENGTH) if row not in duplicates
        ]
        pairs = match_photographs(stated.files, cameras, rows)
        rays = rays_of(pairs, cameras)
        finding, converted, fitted = _check_poses_and_order(rays, cameras, poses, stated)
        if converted is None:
            return [finding], None
        poses = converted
        findings = [finding, *check_calibration(fitted, stated.cameras, photographs.exif)]
        if fitted is not None:
            cameras = _correct_cameras(cameras, fitted)
    if stated.sparse_map is not None:
        findings.append(check_points(stated, poses, cameras, fitted is not None))
    return findings, centres(poses)


def _check_poses_and_order(
    rays: list[Rays], cameras: list[Camera | None], poses: Array, stated: StatedData
) -> tuple[Finding, Array | None, Correction | None]:
    """Check poses, if necessary with corrected cameras or in another order.

    Returns:
        The finding, the poses (N, 4, 4) in the right convention and order, and the correction of
        the cameras. The poses are None if their order is unknown; the correction is None if no
        correction fits.
    """
    finding, converted = check_poses(rays, poses)
    if finding.verdict is Verdict.UNKNOWN:
        return finding, poses, None
    pairs = [r.pair for r in rays]
    if finding.fault != "poses-inexact":
        fitted = fit_correction(pairs, cameras, converted)
        ordered = find_order(rays, converted, stated.names)
        if finding.verdict is Verdict.RIGHT and ordered is not None:
            return *ordered, fitted
        return finding, converted, fitted
    fitted = fit_correction(pairs, cameras, poses)
    if fitted is not None:
        corrected = rays_of(pairs, _correct_cameras(cameras, fitted))
        if mean_agreement(corrected, poses) >= RIGHT_SHARE:
            return check_poses(corrected, poses)[0], poses, fitted
    ordered = find_order(rays, poses, stated.names)
    return (finding, poses, None) if ordered is None else (*ordered, None)


def _correct_cameras(cameras: list[Camera | None], fitted: Correction) -> list[Camera | None]:
    shift = fitted.shift.tolist()
    return [c and correct_camera(c, fitted.focal, shift) for c in cameras]
