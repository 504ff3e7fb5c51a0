"""Ground control points: triangulate their marks, detect wrong points, adjust the model to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from objconnect.ingestion.adjustment import AdjustedModel
from objconnect.ingestion.control_points import ControlPoint
from objconnect.ingestion.georegister import fit_robust_similarity, fit_similarity, is_on_a_line
from objconnect.ingestion.options import IngestOptions
from objconnect.scene.colmap.ground_control import SurveyedPoint, adjust_to_points
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.photographs import Photograph
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.atomic import atomic_folder

Array = NDArray[np.float64]
Role = Literal["used", "check", "wrong", "unseen"]

# Minimum number of points of a similarity, and of points among which a wrong one is detected.
_MIN_POINTS: Final = 3
_MIN_POINTS_TO_DETECT: Final = 5
# Gauss-Newton iterations of a triangulation, and the condition number above which its rays are
# treated as parallel.
_ITERATIONS: Final = 5
_MAX_CONDITION: Final = 1e8
# A point is wrong if its residual exceeds both this (m) and what the scatter of the other points
# explains. Inexact marks move a point by less, mixed-up names by more.
_WRONG_M: Final = 1.0


class ControlResidual(BaseModel):
    """A ground control point after the adjustment.

    Attributes:
        name: name in the list.
        role: "used" in the adjustment; a "check" point; "wrong", which contradicts the others and
            is not used; "unseen", with fewer than two marks, or marks whose rays do not meet.
        marks: number of marks in photographs of the scene.
        off: triangulated minus surveyed position, metres east, north and up; None if the marks
            cannot be triangulated.
        mark_px: root mean square reprojection error of the marks, pixels; None like ``off``.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    role: Role
    marks: int
    off: tuple[float, float, float] | None = None
    mark_px: float | None = None


def control_text(points: Sequence[ControlResidual]) -> list[str]:
    """Return a summary as lines: errors by role, and every point that is wrong or unseen."""
    lines = []
    for role, what in (("used", "used"), ("check", "as check points")):
        residuals = np.array([p.off for p in points if p.role == role and p.off is not None])
        if len(residuals):
            east_north, up = np.sqrt(
                [(residuals[:, :2] ** 2).sum(1).mean(), (residuals[:, 2] ** 2).mean()]
            )
            lines.append(
                f"{len(residuals)} ground control points {what}: horizontal "
                f"{east_north:.3f} m rms, vertical {up:.3f} m rms"
            )
    for point in points:
        if point.role == "wrong" and point.off is not None:
            metres = float(np.linalg.norm(point.off))
            lines.append(f"wrong ground control point: {point.name}: {metres:.2f} m off, not used")
        elif point.off is None:
            lines.append(f"ground control point not seen: {point.name}: {point.marks} marks")
    return lines


def triangulate_marks(model: SparseMap, marks: Mapping[str, Array]) -> tuple[Array, float] | None:
    """Triangulate the marks of a point: position (3,), world metres, and reprojection error.

    Gauss-Newton minimises the sum of squared reprojection errors. The returned error is their root
    mean square, in pixels. The result is None for fewer than two marks in the model's photographs,
    or for marks whose rays do not meet in front of the cameras.
    """
    names = [name for name in marks if name in model.images]
    if len(names) < 2:
        return None
    images = [model.images[name] for name in names]
    xy = torch.from_numpy(np.array([marks[name] for name in names]))
    poses = [image.pose for image in images]
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for image, pose, pixel in zip(images, poses, xy, strict=True):
        ray, valid = image.camera.unproject(pixel[None])
        if not bool(valid[0]):
            return None
        direction = (ray[0] @ pose.rotation).numpy()
        direction /= np.linalg.norm(direction)
        plane = np.eye(3) - np.outer(direction, direction)
        normal, right = normal + plane, right + plane @ image.centre
    if np.linalg.cond(normal) > _MAX_CONDITION:
        return None
    point = torch.from_numpy(np.linalg.solve(normal, right))
    for _ in range(_ITERATIONS):
        residuals, slopes = [], []
        for image, pose, pixel in zip(images, poses, xy, strict=True):
            projected = image.camera.project(pose.transform(point[None]), jacobian=True)
            if not bool(projected.valid[0]):
                return None
            assert projected.jacobian is not None
            residuals.append(projected.xy[0] - pixel)
            slopes.append(projected.jacobian[0] @ pose.rotation)
        step = torch.linalg.lstsq(torch.cat(slopes), torch.cat(residuals)[:, None]).solution
        point = point - step[:, 0]
    squares = torch.stack(residuals) ** 2
    return point.numpy(), float(squares.sum(1).mean().sqrt())


def fit_to_control(
    adjusted: AdjustedModel,
    points: Sequence[ControlPoint],
    origin: Geodetic,
    photographs: Sequence[Photograph],
    work: Path,
    options: IngestOptions,
) -> tuple[AdjustedModel, tuple[ControlResidual, ...]]:
    """Adjust a georegistered model to the control points, and measure all points.

    Three or more points that are not on a line are adjusted together with the keypoints and replace
    GPS. Fewer points, or points on a line, only shift the model. Check points are measured and not
    used.

    Args:
        adjusted: the model after georegistration.
        points: the points, with marks in the scene's photographs.
        origin: geodetic coordinates of the world's origin.
        photographs: photographs of the model; others are ignored.
        work: folder for the adjusted model.
        options: sigma of the points.
    """
    surveyed = {point.name: point.position(origin) for point in points}
    triangulated = {
        p.name: found[0] for p in points if (found := triangulate_marks(adjusted.model, p.marks))
    }
    control = [p for p in points if p.name in triangulated and not p.check]
    wrong = _find_wrong(
        np.array([triangulated[p.name] for p in control]).reshape(-1, 3),
        np.array([surveyed[p.name] for p in control]).reshape(-1, 3),
    )
    used = [point for point, bad in zip(control, wrong, strict=True) if not bad]
    roles: dict[str, Role] = {p.name: "check" if p.check else "wrong" for p in points}
    roles |= {p.name: "unseen" for p in points if p.name not in triangulated}
    roles |= {p.name: "used" for p in used}
    if used:
        targets = [
            SurveyedPoint(
                surveyed[p.name], options.control_sigma_m, _select_marks(p.marks, adjusted.model)
            )
            for p in used
        ]
        positions = np.array([triangulated[p.name] for p in used])
        adjusted = _move_to_points(adjusted, targets, positions, photographs, work)
    return adjusted, tuple(
        _residual(adjusted.model, point, roles[point.name], surveyed[point.name])
        for point in points
    )


def _find_wrong(triangulated: Array, surveyed: Array) -> NDArray[np.bool_]:
    """Return which points contradict the others, (N,); none if they are few or on a line."""
    if len(triangulated) < _MIN_POINTS_TO_DETECT or is_on_a_line(triangulated):
        return np.zeros(len(triangulated), bool)
    return ~fit_robust_similarity(triangulated, surveyed, _WRONG_M)[1]


def _move_to_points(
    adjusted: AdjustedModel,
    points: Sequence[SurveyedPoint],
    triangulated: Array,
    photographs: Sequence[Photograph],
    work: Path,
) -> AdjustedModel:
    """Return the model fitted to points; ``triangulated`` are their positions in it, (N, 3)."""
    surveyed = np.array([point.xyz for point in points])
    if len(points) < _MIN_POINTS or is_on_a_line(triangulated):
        shift = np.column_stack([np.eye(3), (surveyed - triangulated).mean(0)])
        return replace(adjusted, model=adjusted.model.transform(shift))
    # The model of the folder may have another frame: ``adjusted.model`` was moved after it was
    # written if it was raised to known altitudes, or if its poses were imported.
    written = read_model(adjusted.folder)
    found = [(triangulate_marks(written, point.marks), point.xyz) for point in points]
    placed, targets = zip(*[(p[0], xyz) for p, xyz in found if p is not None], strict=True)
    with atomic_folder(work / "control") as folder:
        model = adjust_to_points(
            adjusted.folder,
            photographs,
            fit_similarity(np.array(placed), np.array(targets)),
            points,
            adjusted.refined,
            folder,
        )
    georegistration = replace(adjusted.georegistration, level="control")
    return replace(adjusted, model=model, georegistration=georegistration)


def _select_marks(marks: Mapping[str, Array], model: SparseMap) -> dict[str, Array]:
    return {name: xy for name, xy in marks.items() if name in model.images}


def _residual(
    model: SparseMap, point: ControlPoint, role: Role, surveyed: Array
) -> ControlResidual:
    marks = len(_select_marks(point.marks, model))
    triangulated = triangulate_marks(model, point.marks)
    if triangulated is None:
        return ControlResidual(name=point.name, role=role, marks=marks)
    east, north, up = (triangulated[0] - surveyed).tolist()
    return ControlResidual(
        name=point.name, role=role, marks=marks, off=(east, north, up), mark_px=triangulated[1]
    )
