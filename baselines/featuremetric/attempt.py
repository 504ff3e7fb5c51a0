"""Poses that the alignment led to from one start, and when one of several is believed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from baselines.align.aligner import Alignment
from baselines.featuremetric.options import SearchOptions
from baselines.views import WarpedImage
from scene.geometry.pose import Pose


@dataclass(frozen=True)
class Attempt:
    """The outcome of one start.

    Attributes:
        view: the warped image.
        alignment: of the view.
        fit: cost as a share of the cost by chance; infinite where alignment failed.
        reason: why the pose is not accepted; empty where it is.
    """

    view: WarpedImage
    alignment: Alignment
    fit: float
    reason: str

    @property
    def failed(self) -> bool:
        """Whether there is no pose."""
        return bool(self.alignment.failed[0])

    @property
    def pose(self) -> Pose:
        """``cam_from_world`` of the photograph."""
        return photograph_pose(self.view, self.alignment)


def is_clear(row: int, attempts: Sequence[Attempt], options: SearchOptions) -> bool:
    """Return whether another attempt led to the pose of this one, or all others fit worse."""
    attempt = attempts[row]
    if attempt.reason or not attempt.fit < options.clear_accept_fit:
        return False
    others = [other for other in (*attempts[:row], *attempts[row + 1 :]) if not other.failed]
    if any(_near(o.pose, attempt.pose, options.agreed_m, options.agreed_deg) for o in others):
        return True
    least = attempt.fit + options.clear_margin
    return bool(others) and all(other.fit > least for other in others)


def photograph_pose(view: WarpedImage, alignment: Alignment) -> Pose:
    """Return ``cam_from_world`` of the photograph of an aligned view."""
    pose = alignment.pose
    return view.photograph_pose(Pose(pose.rotation[0], pose.translation[0]))


def stayed_near(aligned: Pose, matched: Pose, options: SearchOptions) -> bool:
    """Return whether a pose aligned from matches stayed near the pose that these gave."""
    return _near(aligned, matched, options.matched_most_m, options.matched_most_deg)


def _near(pose: Pose, other: Pose, most_m: float, most_deg: float) -> bool:
    """Return whether two poses are closer than a distance (metres) and an angle (degrees)."""
    metres, degrees = (float(part) for part in pose.error_to(other))
    return metres < most_m and degrees < most_deg
