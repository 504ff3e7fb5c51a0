"""An alignment problem: the input of ``align`` for a batch of queries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from torch import Tensor

from objconnect.localization.align.options import Options
from objconnect.localization.align.residuals import Level
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.projection import Intrinsics


@dataclass(frozen=True)
class Problem:
    """Queries, the points they are aligned to, and the poses they start from.

    Attributes:
        levels: levels of B queries, coarse to fine.
        points: points (B, N, 3), world metres.
        intrinsics: intrinsics of the queries, batch shape (B,), or one camera for all.
        start: starting poses ``cam_from_world``, batch shape (B,), or (B, K) for K starts of every
            query, which share its features.
        damping: factors (6,) on the Hessian's diagonal for each level, rotation then translation;
            see ``learning.damping``.
        options: options of the alignment.
        mask: (B, N) bool, points to use, or None for all.
        seen_from: (B, N, 3) camera centres of the points' reference images, world metres; None if
            unknown. Only ``covariance.measure_uncertainty`` uses them.
    """

    levels: Sequence[Level]
    points: Tensor
    intrinsics: Intrinsics
    start: Pose
    damping: Sequence[Tensor]
    options: Options
    mask: Tensor | None = None
    seen_from: Tensor | None = None

    def starting_at(self, start: Pose) -> Problem:
        """Return the same problem from other starts, ``cam_from_world`` (B) or (B, K)."""
        return replace(self, start=start)

    def with_options(self, options: Options) -> Problem:
        """Return the same problem with other options."""
        return replace(self, options=options)

    def select_levels(self, part: slice) -> Problem:
        """Return the problem with a range of its levels."""
        return replace(self, levels=self.levels[part], damping=self.damping[part])

    def coarsest(self) -> Problem:
        """Return the problem with the coarsest level alone."""
        return self.select_levels(slice(1))

    def finer(self) -> Problem:
        """Return the problem with all levels but the coarsest."""
        return self.select_levels(slice(1, None))

    def first_points(self, count: int) -> Problem:
        """Return the problem with the first ``count`` points of every query."""
        if count >= self.points.shape[1]:
            return self
        mask = None if self.mask is None else self.mask[:, :count]
        seen_from = None if self.seen_from is None else self.seen_from[:, :count]
        levels = [level.first_points(count) for level in self.levels]
        points = self.points[:, :count]
        return replace(self, levels=levels, points=points, mask=mask, seen_from=seen_from)
