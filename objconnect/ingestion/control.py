"""Ground control points in a model: where it sees them, which are wrong, and the fit to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from objconnect.ingestion.adjustment import Adjusted
from objconnect.ingestion.control_points import ControlPoint
from objconnect.ingestion.georegister import is_on_a_line, robust_similarity, similarity
from objconnect.ingestion.options import IngestOptions
from objconnect.scene.colmap.ground_control import SurveyedPoint, adjust_to_points
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.maps.photographs import Photograph
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.atomic import atomic_folder

Array = NDArray[np.float64]
Role = Literal["used", "check", "wrong", "unseen"]

# Points that a similarity needs, and that tell which of them is wrong.
_FEWEST: Final = 3
_TELLING: Final = 5
# A point is wrong if it is further than this (m), and than sigmas of the others, from where they
# put it: wrong marks move it by less, a name that is mixed up by more.
_WRONG_M: Final = 1.0


class ControlResidual(BaseModel):
    """A ground control point after the adjustment.

    Attributes:
        name: its name in the list.
        role: "used" in the adjustment; a "check" point; "wrong", because it contradicts the others,
            and not used; "unseen", with fewer than two marks in photographs of the scene.
        marks: number of its marks in photographs of the scene.
        off: where its marks put it, minus its surveyed position, metres east, north and up.
        mark_px: root mean square distance of its marks from there, pixels.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    role: Role
    marks: int
    off: tuple[float, float, float] | None = None
    mark_px: float | None = None


def control_text(points: Sequence[ControlResidual]) -> list[str]:
    """Return lines of text: root mean squares by role, and every point that is wrong or unseen."""
    lines = []
    for role, what in (("used", "used"), ("check", "only compared")):
        off = np.array([p.off for p in points if p.role == role and p.off is not None])
        if len(off):
            east_north, up = np.sqrt([(off[:, :2] ** 2).sum(1).mean(), (off[:, 2] ** 2).mean()])
            lines.append(
                f"{len(off)} ground control points {what}: horizontal {east_north:.3f} m rms, "
                f"vertical {up:.3f} m rms"
            )
    for point in points:
        if point.role == "wrong" and point.off is not None:
            metres = float(np.linalg.norm(point.off))
            lines.append(f"wrong ground control point: {point.name}: {metres:.2f} m off, not used")
        elif point.off is None:
            lines.append(f"ground control point not seen: {point.name}: {point.marks} marks")
    return lines


def triangulate_marks(model: SparseMap, marks: Mapping[str, Array]) -> tuple[Array, float] | None:
    """Return the point that marks show, (3,) world metres, and their distance from it.

    The point has the least sum of squared distances in pixels, by Gauss and Newton. The distance is
    the root mean square, in pixels. The result is None for fewer than two marks in the model's
    photographs, or for marks whose rays do not meet in front of the cameras.
    """
    there = [name for name in marks if name in model.images]
    if len(there) < 2:
        return None
    images = [model.images[name] for name in there]
    xy = torch.from_numpy(np.array([marks[name] for name in there]))
    poses = [image.pose for image in images]
    across, onto = np.zeros((3, 3)), np.zeros(3)
    for image, pose, pixel in zip(images, poses, xy, strict=True):
        ray, valid = image.camera.unproject(pixel[None])
        if not bool(valid[0]):
            return None
        direction = (ray[0] @ pose.rotation).numpy()
        direction /= np.linalg.norm(direction)
        plane = np.eye(3) - np.outer(direction, direction)
        across, onto = across + plane, onto + plane @ image.centre
    if np.linalg.cond(across) > 1e8:  # the rays are parallel
        return None
    point = torch.from_numpy(np.linalg.solve(across, onto))
    for _ in range(5):
        residuals, slopes = [], []
        for image, pose, pixel in zip(images, poses, xy, strict=True):
            seen = image.camera.project(pose.transform(point[None]), jacobian=True)
            if not bool(seen.valid[0]):
                return None
            assert seen.jacobian is not None
            residuals.append(seen.xy[0] - pixel)
            slopes.append(seen.jacobian[0] @ pose.rotation)
        step = torch.linalg.lstsq(torch.cat(slopes), torch.cat(residuals)[:, None]).solution
        point = point - step[:, 0]
    off = torch.stack(residuals)
    return point.numpy(), float((off**2).sum(1).mean().sqrt())


def fit_to_control(
    adjusted: Adjusted,
    points: Sequence[ControlPoint],
    origin: Geodetic,
    taken: Sequence[Photograph],
    work: Path,
    options: IngestOptions,
) -> tuple[Adjusted, tuple[ControlResidual, ...]]:
    """Adjust a model in the world to the points that are no check points, and measure all of them.

    Three or more points that are not on a line are adjusted together with the pixels, and GPS has
    no influence any more. Fewer points shift the model.

    Args:
        adjusted: the model as GPS placed it.
        points: the points, with marks in the photographs as they are in the scene.
        origin: place of the world's origin.
        taken: photographs of the model; further ones are ignored.
        work: folder for the adjusted model.
        options: sigma of the points.
    """
    surveyed = {point.name: point.position(origin) for point in points}
    found = {
        p.name: seen[0] for p in points if (seen := triangulate_marks(adjusted.model, p.marks))
    }
    free = [p for p in points if p.name in found and not p.check]
    wrong = _wrong(
        np.array([found[p.name] for p in free]).reshape(-1, 3),
        np.array([surveyed[p.name] for p in free]).reshape(-1, 3),
    )
    used = [point for point, bad in zip(free, wrong, strict=True) if not bad]
    roles: dict[str, Role] = {p.name: "check" if p.check else "wrong" for p in points}
    roles |= {p.name: "unseen" for p in points if p.name not in found}
    roles |= {p.name: "used" for p in used}
    if used:
        fixed = [
            SurveyedPoint(
                surveyed[p.name], options.control_sigma_m, _inside(p.marks, adjusted.model)
            )
            for p in used
        ]
        there = np.array([found[p.name] for p in used])
        adjusted = _fit_to_control(adjusted, fixed, there, taken, work)
    return adjusted, tuple(
        _residual(adjusted.model, point, roles[point.name], surveyed[point.name])
        for point in points
    )


def _wrong(found: Array, surveyed: Array) -> NDArray[np.bool_]:
    """Return which points contradict the others, (N,); too few points tell of none."""
    if len(found) < _TELLING or is_on_a_line(found):
        return np.zeros(len(found), bool)
    return ~robust_similarity(found, surveyed, _WRONG_M)[1]


def _fit_to_control(
    adjusted: Adjusted,
    points: Sequence[SurveyedPoint],
    found: Array,
    taken: Sequence[Photograph],
    work: Path,
) -> Adjusted:
    """Return the model after the fit to points that it has found elsewhere, (N, 3)."""
    surveyed = np.array([point.xyz for point in points])
    if len(points) < _FEWEST or is_on_a_line(found):
        shift = np.column_stack([np.eye(3), (surveyed - found).mean(0)])
        return replace(adjusted, model=adjusted.model.transform(shift))
    with atomic_folder(work / "control") as folder:
        model = adjust_to_points(
            adjusted.folder,
            taken,
            similarity(found, surveyed),
            points,
            adjusted.refined,
            folder,
        )
    placed = replace(adjusted.placed, level="control")
    return replace(adjusted, model=model, placed=placed)


def _inside(marks: Mapping[str, Array], model: SparseMap) -> dict[str, Array]:
    return {name: xy for name, xy in marks.items() if name in model.images}


def _residual(
    model: SparseMap, point: ControlPoint, role: Role, surveyed: Array
) -> ControlResidual:
    marks = len(_inside(point.marks, model))
    seen = triangulate_marks(model, point.marks)
    if seen is None:
        return ControlResidual(name=point.name, role=role, marks=marks)
    east, north, up = (seen[0] - surveyed).tolist()
    return ControlResidual(
        name=point.name, role=role, marks=marks, off=(east, north, up), mark_px=seen[1]
    )
