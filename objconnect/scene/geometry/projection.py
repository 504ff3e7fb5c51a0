"""Batched projection with analytic Jacobians for every camera model of the project.

One formula serves all perspective models, with missing coefficients zero; a second one serves the
fisheye model. Pixels are COLMAP's: the centre of the top-left pixel is (0.5, 0.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

# Points with a smaller z (in units of the camera frame) are treated as behind the camera.
MIN_DEPTH: Final = 1e-6
# Points with a larger |x/z| or |y/z| are treated as invalid too, because its powers overflow single
# precision.
MAX_SLOPE: Final = 1e4
_NEWTON_STEPS = 30
# Number of coefficients of a perspective model with polynomial, not rational, distortion.
_POLYNOMIAL_COUNT = 4
# For a rational distortion, Newton's method stays within this share of the fold-over limit and
# starts from the result of this many bisections.
_LIMIT_SHARE, _BISECTIONS = 0.9999, 24
# Smallest absolute denominator, which keeps pixels finite.
_MIN_DENOMINATOR = 1e-6
# Largest first angle and largest angle (rad) of Newton's method for a fisheye: 86 and 89 degrees.
_START_ANGLE, _MAX_ANGLE = 1.5, 1.5533


class Projection(NamedTuple):
    """The result of ``Intrinsics.project``.

    Attributes:
        xy: pixels, (..., N, 2); finite everywhere, meaningful where ``valid``.
        valid: (..., N) bool: the point is in front of the camera and inside the fold-over limit. It
            may still lie outside the image: see ``Camera.contains``.
        jacobian: d(xy) / d(point in camera frame), (..., N, 2, 3); None if not requested.
    """

    xy: Tensor
    valid: Tensor
    jacobian: Tensor | None


@dataclass(frozen=True)
class Intrinsics:
    """Intrinsics of one camera, or of a batch of cameras that are all perspective or all fisheye.

    Attributes:
        fisheye: whether the model is equidistant (OPENCV_FISHEYE) rather than perspective.
        focal: focal lengths, (..., 2) pixels.
        principal: principal points, (..., 2) pixels.
        distortion: k1 k2 p1 p2, or k1 k2 k3 k4 for the fisheye, (..., 4); or k1 k2 p1 p2 k3 k4 k5
            k6, (..., 8), the last three in a denominator.
        limit: fold-over limit, (...): radius x/z, or angle (rad) for the fisheye.
    """

    fisheye: bool
    focal: Tensor
    principal: Tensor
    distortion: Tensor
    limit: Tensor

    @classmethod
    def stack(cls, cameras: Sequence[Intrinsics]) -> Intrinsics:
        """Return cameras that are all perspective, or all fisheye, as one batch.

        Args:
            cameras: at least one camera; all have the same batch dimensions.
        """
        count = max(camera.distortion.shape[-1] for camera in cameras)
        distortion = [pad(c.distortion, (0, count - c.distortion.shape[-1])) for c in cameras]
        return cls(
            fisheye=cameras[0].fisheye,
            focal=torch.stack([camera.focal for camera in cameras]),
            principal=torch.stack([camera.principal for camera in cameras]),
            distortion=torch.stack(distortion),
            limit=torch.stack([camera.limit for camera in cameras]),
        )

    def project(self, points: Tensor, jacobian: bool = False) -> Projection:
        """Project points (..., N, 3) of the camera frame.

        The batch dimensions of the intrinsics precede N.

        Examples:
            >>> camera = Intrinsics(
            ...     fisheye=False,
            ...     focal=torch.tensor([100.0, 100.0]),
            ...     principal=torch.tensor([32.0, 24.0]),
            ...     distortion=torch.zeros(4),
            ...     limit=torch.tensor(float("inf")),
            ... )
            >>> projected = camera.project(torch.tensor([[0.1, 0.0, 1.0], [0.0, 0.0, -1.0]]))
            >>> projected.xy[0].tolist(), projected.valid.tolist()
            ([42.0, 24.0], [True, False])
        """
        z = points[..., 2]
        lateral = torch.maximum(points[..., 0].abs(), points[..., 1].abs())
        in_front = (z > MIN_DEPTH) & (lateral < MAX_SLOPE * z)
        inverse_z = 1 / torch.where(in_front, z, torch.ones_like(z))
        uv = torch.where(in_front[..., None], points[..., :2] * inverse_z[..., None], 0)
        distorted, local, inside = self._distort(uv, jacobian)
        focal = self.focal[..., None, :]
        xy = focal * distorted + self.principal[..., None, :]
        if local is None:
            return Projection(xy, in_front & inside, None)
        # The chain rule for u = x/z and v = y/z, written out: a matrix product per point is slower.
        u, v = uv.unbind(-1)
        d_u, d_v = (focal[..., None] * local * inverse_z[..., None, None]).unbind(-1)
        d_z = -(d_u * u[..., None] + d_v * v[..., None])
        return Projection(xy, in_front & inside, torch.stack([d_u, d_v, d_z], -1))

    def unproject(self, xy: Tensor) -> tuple[Tensor, Tensor]:
        """Return the rays with z = 1 through pixels (..., N, 2), and which of them are valid.

        Newton's method inverts the distortion. A pixel is invalid if no ray inside the fold-over
        limit projects to it.

        Returns:
            Rays (..., N, 3) of the camera frame, and (..., N) bool.
        """
        target = (xy - self.principal[..., None, :]) / self.focal[..., None, :]
        tolerance = max(1e-7, 16 * torch.finfo(target.dtype).eps)
        if self.fisheye:
            radius = target.norm(dim=-1)
            theta = radius.clamp(max=_START_ANGLE)
            for _ in range(_NEWTON_STEPS):
                value, slope = self._fisheye_angle(theta)
                theta = theta - (value - radius) / slope.clamp_min(1e-3)
                theta = theta.clamp(0.0, _MAX_ANGLE)
            value, _ = self._fisheye_angle(theta)
            converged = ((value - radius).abs() < tolerance) & (theta < self.limit[..., None])
            scale = torch.tan(theta) / radius.clamp_min(1e-12)
            scale = torch.where(radius < 1e-9, torch.ones_like(scale), scale)
            uv = target * scale[..., None]
        else:
            uv = self._newton_start(target)
            distorted = bool(self.distortion.any())
            for _ in range(_NEWTON_STEPS if distorted else 0):
                value, local, _ = self._distort(uv, jacobian=True)
                assert local is not None
                # Bounding the determinant keeps pixels without a solution finite.
                a, b, c, d = local.flatten(-2).unbind(-1)
                det = a * d - b * c
                det = torch.where(det.abs() < 1e-6, torch.full_like(det, 1e-6), det)
                rx, ry = (target - value).unbind(-1)
                step = torch.stack([d * rx - b * ry, a * ry - c * rx], -1) / det[..., None]
                uv = self._clamp_to_limit(uv + step.clamp(-1, 1))
                if not (step.abs() > torch.finfo(step.dtype).eps).any():
                    break
            value, _, inside = self._distort(uv, jacobian=False)
            converged = ((value - target).norm(dim=-1) < tolerance) & inside
        rays = torch.cat([uv, torch.ones_like(uv[..., :1])], -1)
        return rays, converged

    def _distort(self, uv: Tensor, jacobian: bool) -> tuple[Tensor, Tensor | None, Tensor]:
        """Distort normalised coordinates (..., N, 2).

        Returns:
            The distorted coordinates (..., N, 2), their Jacobian (..., N, 2, 2) if requested, and
            whether each point is inside the fold-over limit, (..., N).
        """
        if self.fisheye:
            return self._distort_fisheye(uv, jacobian)
        if not self.distortion.any():
            # A shortcut for cameras without distortion: an alignment projects hundreds of times.
            inside = uv.square().sum(-1) < self.limit[..., None] ** 2
            eye = torch.eye(2, dtype=uv.dtype, device=uv.device)
            return uv, eye.expand(*uv.shape[:-1], 2, 2) if jacobian else None, inside
        k1, k2, p1, p2, *more = (c[..., None] for c in self.distortion.unbind(-1))
        u, v = uv.unbind(-1)
        uu, vv, uv2 = u * u, v * v, 2 * u * v
        r2 = uu + vv
        if more:
            radial, slope = _rational(r2, (k1, k2, *more))
        else:
            radial = 1 + r2 * (k1 + k2 * r2)
            slope = 2 * (k1 + 2 * k2 * r2)  # d(radial)/d(r2) times 2
        distorted = torch.stack(
            [
                u * radial + p1 * uv2 + p2 * (r2 + 2 * uu),
                v * radial + p2 * uv2 + p1 * (r2 + 2 * vv),
            ],
            -1,
        )
        j00 = radial + slope * uu + 2 * p1 * v + 6 * p2 * u
        j11 = radial + slope * vv + 2 * p2 * u + 6 * p1 * v
        j01 = slope * u * v + 2 * p1 * u + 2 * p2 * v
        # Tangential terms can fold the plane inside the radial limit: the determinant shows it.
        inside = (r2 < self.limit[..., None] ** 2) & (j00 * j11 - j01 * j01 > 0)
        if not jacobian:
            return distorted, None, inside
        local = torch.stack([j00, j01, j01, j11], -1).reshape(*uv.shape[:-1], 2, 2)
        return distorted, local, inside

    def _newton_start(self, target: Tensor) -> Tensor:
        """Return the start of Newton's method for distorted coordinates (..., N, 2).

        A rational distortion may be too steep to start from ``target``. Its start is the solution
        without tangential terms, found by bisection.
        """
        k1, k2, _, _, *more = (c[..., None] for c in self.distortion.unbind(-1))
        if not more:
            return target
        distorted = target.norm(dim=-1)
        middle = low = torch.zeros_like(distorted)
        high = (_LIMIT_SHARE * self.limit[..., None]).clamp_max(MAX_SLOPE).expand_as(distorted)
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            stretch, _ = _rational(middle * middle, (k1, k2, *more))
            short = middle * stretch < distorted
            low, high = torch.where(short, middle, low), torch.where(short, high, middle)
        start: Tensor = target * (middle / distorted.clamp_min(1e-12))[..., None]
        return start

    def _clamp_to_limit(self, uv: Tensor) -> Tensor:
        """Clamp coordinates (..., N, 2) of a rational distortion to the fold-over limit.

        Beyond a zero of the denominator, Newton's method would converge to another branch.
        """
        if self.distortion.shape[-1] == _POLYNOMIAL_COUNT:
            return uv
        limit = (_LIMIT_SHARE * self.limit[..., None]).clamp_max(MAX_SLOPE)
        radius = uv.norm(dim=-1)
        return uv * torch.where(radius > limit, limit / radius.clamp_min(MIN_DEPTH), 1)[..., None]

    def _fisheye_angle(self, theta: Tensor) -> tuple[Tensor, Tensor]:
        """Return the distorted angle and its derivative, both (..., N), of angles (..., N)."""
        k1, k2, k3, k4 = (c[..., None] for c in self.distortion.unbind(-1))
        t2 = theta * theta
        value = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        slope = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
        return value, slope

    def _distort_fisheye(self, uv: Tensor, jacobian: bool) -> tuple[Tensor, Tensor | None, Tensor]:
        """Distort normalised coordinates by the fisheye model, as ``_distort`` does."""
        radius = uv.norm(dim=-1)
        centre = radius < 1e-9
        r = torch.where(centre, torch.ones_like(radius), radius)
        theta = torch.atan(radius)
        value, slope = self._fisheye_angle(theta)
        scale = torch.where(centre, torch.ones_like(r), value / r)
        distorted = uv * scale[..., None]
        inside = theta < self.limit[..., None]
        if not jacobian:
            return distorted, None, inside
        d_radial = slope / (1 + radius * radius)
        direction = uv / r[..., None]
        outer = direction[..., :, None] * direction[..., None, :]
        eye = torch.eye(2, dtype=uv.dtype, device=uv.device)
        local = scale[..., None, None] * eye + (d_radial - scale)[..., None, None] * outer
        return distorted, local, inside


def _rational(r2: Tensor, coefficients: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """Return the radial factor at squared radii, and twice its derivative by them, each (..., N).

    Args:
        r2: squared radii, (..., N).
        coefficients: k1 to k3 of the numerator and k4 to k6 of the denominator.
    """
    k1, k2, k3, k4, k5, k6 = coefficients
    denominator = 1 + r2 * (k4 + r2 * (k5 + k6 * r2))
    denominator = torch.where(
        denominator.abs() < _MIN_DENOMINATOR,
        torch.full_like(denominator, _MIN_DENOMINATOR),
        denominator,
    )
    radial = (1 + r2 * (k1 + r2 * (k2 + k3 * r2))) / denominator
    numerator_slope = k1 + r2 * (2 * k2 + 3 * k3 * r2)
    denominator_slope = k4 + r2 * (2 * k5 + 3 * k6 * r2)
    return radial, 2 * (numerator_slope - radial * denominator_slope) / denominator
