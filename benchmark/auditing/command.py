"""The command ``audit``: which statements of a data set its photographs contradict."""

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
    rays_of,
    share,
)
from benchmark.auditing.calibration import (
    Correction,
    check_calibration,
    correct_camera,
    correction,
)
from benchmark.auditing.files import Photographs, check_files, fit_cameras, look_at
from benchmark.auditing.findings import Audit, Finding, Verdict, unknown
from benchmark.auditing.map_points import check_points
from benchmark.auditing.matches import match_photographs
from benchmark.auditing.opening import open_data
from benchmark.auditing.page import check_page, write_page
from benchmark.auditing.photograph_order import find_order
from benchmark.auditing.positions import FOLLOW, check_positions
from benchmark.auditing.statements import Stated, centres, sample
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.imports.poses import Frame
from objconnect.scene.quantities.doubts import summarize_doubts

Array = NDArray[np.float64]

log = logging.getLogger(__name__)

# Photographs that are matched with each other, in runs of neighbours.
_MATCHED, _RUN = 32, 8


def audit(
    path: Path,
    images: Path | None = None,
    camera: Camera | None = None,
    out: Path | None = None,
    frame: Frame | None = None,
) -> list[Audit]:
    """Audit a data set, or each data set of a folder that holds several.

    Args:
        path: a scene, a flight, or poses of another program; see ``opening.open_data``.
        images: folder of the photographs; None looks where the format has them.
        camera: camera of the photographs where the data set states none.
        out: HTML file for the verdicts; None writes none.
        frame: frame of another program's poses, where their file leaves it open.

    Raises:
        InputError: no reader knows the path, a file is damaged, or the page cannot be written.
    """
    if out is not None:
        check_page(out, [path, *([images] if images is not None else [])])
    audits = [_audit_one(stated) for stated in open_data(path, images, camera, frame)]
    if out is not None:
        write_page(audits, out)
    return audits


def _audit_one(stated: Stated) -> Audit:
    photographs = look_at(stated)
    told = zip(stated.names, photographs.exif, strict=True)
    for line in summarize_doubts({name: exif.doubts for name, exif in told if exif is not None}):
        log.warning("%s", line)
    findings = list(check_files(stated, photographs))
    positions, named, plan = stated.positions, False, np.zeros((0, 4))
    if stated.cam_from_world is not None:
        geometry, positions = _geometry(stated, photographs)
        named = any(f.check == CHECK and f.verdict is Verdict.RIGHT for f in geometry)
        findings += geometry
    if positions is None and stated.cam_from_world is not None:
        why = "not compared: which position is of which photograph is not known"
        findings.append(unknown(FOLLOW, why))
    else:
        followed, plan = check_positions(stated, positions, photographs.exif, named)
        findings += followed
    drawn = tuple(tuple(row) for row in plan.tolist())
    return Audit(stated.subject, stated.kind, len(stated), tuple(findings), drawn)


def _geometry(stated: Stated, photographs: Photographs) -> tuple[list[Finding], Array | None]:
    """Judge poses, cameras and points; return the camera centres as they must be read.

    They are None where it is not known which photograph they are of.
    """
    assert stated.cam_from_world is not None
    poses = stated.cam_from_world
    cameras = fit_cameras(stated, photographs)
    if stated.files is None:
        findings = [unknown(CHECK, "there are no photographs to compare with")]
        found = None
    elif all(one is None for one in cameras):
        why = "the data set states no camera, and EXIF tells no focal length: give --camera"
        findings, found = [unknown(CHECK, why)], None
    else:
        repeated = photographs.duplicates
        rows = [row for row in sample(len(stated), _MATCHED, _RUN) if row not in repeated]
        pairs = match_photographs(stated.files, cameras, rows)
        rays = rays_of(pairs, cameras)
        finding, read, found = _poses(rays, cameras, poses, stated)
        if read is None:
            return [finding], None
        poses = read
        findings = [finding, *check_calibration(found, stated.cameras, photographs.exif)]
        if found is not None:
            cameras = _better(cameras, found)
    if stated.sparse_map is not None:
        findings.append(check_points(stated, poses, cameras, found is not None))
    return findings, centres(poses)


def _poses(
    rays: list[Rays], cameras: list[Camera | None], poses: Array, stated: Stated
) -> tuple[Finding, Array | None, Correction | None]:
    """Judge poses, where necessary with corrected cameras or in another order."""
    finding, read = check_poses(rays, poses)
    if finding.verdict is Verdict.UNKNOWN:
        return finding, poses, None
    pairs = [r.pair for r in rays]
    if finding.fault != "poses-inexact":
        found = correction(pairs, cameras, read)
        ordered = find_order(rays, read, stated.names)
        if finding.verdict is Verdict.RIGHT and ordered is not None:
            return *ordered, found
        return finding, read, found
    found = correction(pairs, cameras, poses)
    if found is not None:
        straight = rays_of(pairs, _better(cameras, found))
        if share(straight, poses) >= RIGHT_SHARE:
            return check_poses(straight, poses)[0], poses, found
    ordered = find_order(rays, poses, stated.names)
    return (finding, poses, None) if ordered is None else (*ordered, None)


def _better(cameras: list[Camera | None], found: Correction) -> list[Camera | None]:
    shift = found.shift.tolist()
    return [c and correct_camera(c, found.focal, shift) for c in cameras]
