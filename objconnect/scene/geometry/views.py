"""Views: photographs rotated north up, resized to one scale, or levelled.

Networks match such views better than the photographs, whose heights and headings differ within a
survey; neighbouring lines have opposite headings. Rotation and scale come from the poses of the
map, or from the prior of a query, which is exact to a few degrees and metres. A rotated and resized
photograph equals one of another camera with a rotated lens. A photograph with a larger tilt than
the map's is levelled: warped to a camera of less tilt at the same position.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.projection import MIN_DEPTH

# Features within this distance (px of the view) of the edge of the photograph are affected by the
# black beyond it.
MARGIN: Final = 8.0
# Largest vertical component of the optical axis of a camera that looks down.
_MAX_AXIS_UP: Final = -0.5
# Smaller rotations (radians) and relative changes of scale leave a photograph unchanged.
_SAME_ANGLE, _SAME_SCALE = 1e-3, 1e-3
# Largest rotation of the optical axis by levelling, radians. A larger one would stretch the image
# too much.
_MAX_LEVELLING: Final = np.pi / 4
# Largest distance of a pixel of a levelled view from its axis, in focal lengths.
_MAX_RADIUS: Final = 2.2
# Largest ratio of the pixels of a levelled view to those of the photograph at the same scale.
_MAX_PIXEL_RATIO: Final = 2.0


def looks_down(cam_from_world: NDArray[np.float64]) -> bool:
    """Return whether a camera of this rotation (3, 3) looks at least 30 degrees downwards."""
    return bool(cam_from_world[2, 2] <= _MAX_AXIS_UP)


def north_angle(cam_from_world: NDArray[np.float64]) -> float:
    """Return the clockwise angle (rad) from the image's up direction to north on the ground.

    For views within 30 degrees of the horizon, as from a street, it is the angle to the zenith.

    Args:
        cam_from_world: rotation (3, 3).

    Examples:
        A camera that looks straight down, with north at the top of the image:

        >>> north_angle(np.diag([1.0, -1.0, -1.0]))
        0.0
    """
    if not looks_down(cam_from_world):
        up_axis = cam_from_world[:, 2]
        return float(np.arctan2(up_axis[0], -up_axis[1]))
    return map_angle(cam_from_world)


def map_angle(cam_from_world: NDArray[np.float64]) -> float:
    """Return the clockwise angle (rad) from up in an image to the map's north, the best fit.

    For views from above it equals ``north_angle``; it is defined for views of the horizon too.

    Args:
        cam_from_world: rotation (3, 3).
    """
    east_axis, north_axis, _ = cam_from_world.T
    # The rotation about the optical axis that best brings east to the right and north up.
    return float(np.arctan2(north_axis[0] + east_axis[1], east_axis[0] - north_axis[1]))


def tilt(cam_from_world: NDArray[np.float64]) -> float:
    """Return the angle (rad) between a camera's axis and nadir; 0 looks straight down.

    Examples:
        >>> tilt(np.diag([1.0, -1.0, -1.0]))
        0.0
    """
    return float(np.arccos(np.clip(-cam_from_world[2, 2], -1, 1)))


def level_rotation(cam_from_world: NDArray[np.float64], target_tilt: float) -> NDArray[np.float64]:
    """Return the rotation (3, 3) of a camera levelled to a tilt of ``target_tilt`` rad, north up.

    The axis rotates by 45 degrees at most. A camera of less tilt is only rotated north up.
    """
    down = np.diag([1.0, -1.0, -1.0])
    north_up = roll_rotation(map_angle(cam_from_world)) @ cam_from_world
    vector = cv2.Rodrigues(north_up @ down)[0][:, 0]
    angle = float(np.linalg.norm(vector))
    new_tilt = max(target_tilt, angle - _MAX_LEVELLING)
    if angle <= new_tilt:
        return np.asarray(north_up)
    return np.asarray(cv2.Rodrigues(vector * (new_tilt / angle))[0] @ down)


def roll_rotation(angle: float) -> NDArray[np.float64]:
    """Return the rotation (3, 3) of camera coordinates for a counter-clockwise image rotation."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])


def rotate_north_up(cam_from_world: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation (3, 3) of a camera rotated about its axis so that north is up."""
    return np.asarray(roll_rotation(north_angle(cam_from_world)) @ cam_from_world)


_PixelTransform = Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True)
class WarpedImage:
    """A view: a photograph rotated, resized or levelled.

    Attributes:
        picture: (h, w, 3) uint8; black outside the photograph.
        camera: camera of the view.
        view_from_camera: (3, 3) rotation from the photograph's camera frame.
        in_photograph: maps pixels of the view (N, 2) to pixels of the photograph; NaN if invalid.
        scale: pixels of the view per pixel of the photograph, at its axis.
        size: width and height (2,) of the photograph.
    """

    picture: NDArray[np.uint8]
    camera: Camera
    view_from_camera: NDArray[np.float64]
    in_photograph: _PixelTransform
    scale: float
    size: NDArray[np.int64]

    def shows(self, xy: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether pixels of the view (..., 2) lie in the photograph, away from its edge.

        The distance from the edge is at least ``MARGIN``, in pixels of the view.
        """
        source, margin = self.in_photograph(xy.reshape(-1, 2)), MARGIN / self.scale
        (x, y), (right, bottom) = source.T, self.size - margin
        inside = (x >= margin) & (x <= right) & (y >= margin) & (y <= bottom)
        return np.asarray(inside.reshape(xy.shape[:-1]))

    @cached_property
    def is_filled(self) -> bool:
        """Return whether the photograph fills the view."""
        return bool(np.allclose(self.view_from_camera, np.eye(3)))

    def crop_middle(self, side: int) -> WarpedImage:
        """Return the central crop of at most ``side`` pixels in width and height."""
        whole = np.array([self.camera.width, self.camera.height])
        size = np.minimum(whole, side)
        corner = (whole - size) // 2
        if not corner.any():
            return self
        (left, top), (width, height) = corner.tolist(), size.tolist()
        return replace(
            self,
            picture=np.ascontiguousarray(self.picture[top : top + height, left : left + width]),
            camera=self.camera.crop(left, top, width, height),
            in_photograph=partial(_add_corner, self.in_photograph, corner),
        )

    def pose(self, cam_from_world: Pose) -> Pose:
        """Return the view's pose, given the photograph's."""
        return _rotate_pose(torch.from_numpy(self.view_from_camera), cam_from_world)

    def photograph_pose(self, view_from_world: Pose) -> Pose:
        """Return the photograph's pose, given the view's."""
        return _rotate_pose(torch.from_numpy(self.view_from_camera.T.copy()), view_from_world)

    def photograph_covariance(self, covariance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the covariance (6, 6) of the photograph's pose, given the view's covariance.

        An infinite covariance stays unchanged.
        """
        if not np.isfinite(covariance).all():
            return covariance
        inverse = np.kron(np.eye(2), self.view_from_camera.T)
        return np.asarray(inverse @ covariance @ inverse.T)


def _rotate_pose(rotation: torch.Tensor, pose: Pose) -> Pose:
    return Pose(rotation @ pose.rotation, pose.translation @ rotation.T)


def warp_image(
    rgb: NDArray[np.uint8], camera: Camera, angle: float = 0.0, scale: float = 1.0
) -> WarpedImage:
    """Rotate a whole photograph counter-clockwise and resize it.

    Args:
        rgb: (H, W, 3) the photograph.
        camera: its camera.
        angle: radians, for instance from ``north_angle``.
        scale: pixels of the view per pixel of the photograph.
    """
    size = np.array([camera.width, camera.height])
    if abs(angle) < _SAME_ANGLE and abs(scale - 1) < _SAME_SCALE:
        return WarpedImage(rgb, camera, np.eye(3), lambda xy: xy, 1.0, size)
    # Pixels become square, so that the same camera model describes the rotated lens.
    focal = np.array(camera.focal)
    per_axis = scale * focal.mean() / focal
    rotation = roll_rotation(angle)
    extent = np.abs(rotation[:2, :2]) @ (size * per_axis)
    view_size = np.ceil(extent - 1e-6).astype(int)
    linear = rotation[:2, :2] * per_axis
    affine = np.column_stack([linear, view_size / 2 - linear @ (size / 2)])
    params = (*(focal * per_axis), *(linear @ camera.principal + affine[:, 2]))
    if camera.is_fisheye:
        model, lens = "OPENCV_FISHEYE", camera.distortion
    else:
        k1, k2, p1, p2, *more = camera.distortion
        # Radial distortion has no direction; tangential distortion rotates with the image.
        p2, p1 = (rotation[:2, :2] @ [p2, p1]).tolist()
        model, lens = "FULL_OPENCV" if more else "OPENCV", (k1, k2, p1, p2, *more)
    view = Camera(model, int(view_size[0]), int(view_size[1]), (*(float(p) for p in params), *lens))
    # The inverse of a rotation after a scaling, written out: starting LAPACK's threads takes 2 ms.
    inverse = rotation[:2, :2].T / per_axis[:, None]
    photograph_from_view = partial(_undo_affine, inverse, affine[:, 2])
    axis_scale = float(np.linalg.norm(affine[:, 0]))
    return WarpedImage(
        resample(rgb, affine, view_size), view, rotation, photograph_from_view, axis_scale, size
    )


def level_image(
    rgb: NDArray[np.uint8], camera: Camera, view_from_camera: NDArray[np.float64], scale: float
) -> WarpedImage:
    """Warp a photograph to a pinhole camera of another rotation at the same position.

    The view extends to 65 degrees off the axis at most; oblique ground is stretched.

    Args:
        rgb: (H, W, 3) the photograph.
        camera: its camera.
        view_from_camera: (3, 3) rotation from camera to view coordinates; to level a photograph of
            rotation R, ``level_rotation(R, target_tilt) @ R.T``.
        scale: pixels of the view per pixel of the photograph, at the axes. It is reduced if the
            view would have more than twice the pixels.
    """
    size = np.array([camera.width, camera.height])
    edge = np.linspace(0, 1, 33)
    x, y = np.meshgrid(edge * size[0], edge * size[1])
    rays, valid = camera.unproject(torch.from_numpy(np.stack([x.ravel(), y.ravel()], -1)))
    view_rays = rays[valid].double().numpy() @ view_from_camera.T
    normalised = view_rays[:, :2] / np.maximum(view_rays[:, 2:], 1e-6)
    normalised = normalised[np.linalg.norm(normalised, axis=1) <= _MAX_RADIUS]
    extent = np.ptp(normalised, axis=0)
    focal = float(np.mean(camera.focal))
    pixels = float(np.prod(extent)) * focal**2 / float(np.prod(size))
    focal *= scale * min(1.0, (_MAX_PIXEL_RATIO / pixels) ** 0.5)
    width, height = np.maximum(np.ceil(extent * focal), 1).astype(int).tolist()
    principal = (-normalised.min(0) * focal).tolist()
    view = Camera("PINHOLE", width, height, (focal, focal, *principal))
    photograph_from_view = partial(_to_camera_pixels, view, view_from_camera, camera)
    grid = view.pixel_grid(torch.float64).reshape(-1, 2).numpy()
    shrink = np.minimum(np.maximum(np.round(size * scale), 1), size).astype(int)
    small = np.asarray(cv2.resize(rgb, shrink.tolist(), interpolation=cv2.INTER_AREA), np.uint8)
    # OpenCV counts from the first pixel's centre.
    source = (
        (photograph_from_view(grid) * (shrink / size) - 0.5)
        .astype(np.float32)
        .reshape(height, width, 2)
    )
    source = np.nan_to_num(source, nan=-1e4)
    picture = cv2.remap(small, source[..., 0], source[..., 1], cv2.INTER_LINEAR)
    axis_scale = focal / float(np.mean(camera.focal))
    return WarpedImage(
        np.asarray(picture, np.uint8),
        view,
        view_from_camera,
        photograph_from_view,
        axis_scale,
        size,
    )


def _add_corner(
    in_photograph: _PixelTransform, corner: NDArray[np.int64], xy: NDArray[np.float64]
) -> NDArray[np.float64]:
    return in_photograph(xy + corner)


def _undo_affine(
    linear: NDArray[np.float64], shift: NDArray[np.float64], xy: NDArray[np.float64]
) -> NDArray[np.float64]:
    # Written out, because a matrix product of this size would start the threads of BLAS.
    (a, b), (c, d) = linear.tolist()
    x, y = (xy - shift).T
    return np.stack([a * x + b * y, c * x + d * y], -1)


def _to_camera_pixels(
    view: Camera, view_from_camera: NDArray[np.float64], camera: Camera, xy: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the pixels of a camera for pixels (N, 2) of a pinhole view, NaN if invalid."""
    if not camera.is_fisheye and not any(camera.distortion):
        return _apply_homography(_homography(view, view_from_camera, camera), xy)
    rays, _ = view.unproject(torch.from_numpy(np.asarray(xy, np.float64)))
    projected = camera.project(rays.double() @ torch.from_numpy(view_from_camera))
    return np.where(projected.valid[:, None].numpy(), projected.xy.numpy(), np.nan)


def _homography(
    view: Camera, view_from_camera: NDArray[np.float64], camera: Camera
) -> NDArray[np.float64]:
    """Return the homography (3, 3) from pixels of a view to those of a camera of one position.

    Both have no distortion. Its third row gives the depth of a ray whose depth in the view is 1.
    """
    (fx, fy), (cx, cy) = view.focal, view.principal
    rays = np.array([[1 / fx, 0, -cx / fx], [0, 1 / fy, -cy / fy], [0, 0, 1]])
    return np.asarray(camera.calibration @ view_from_camera.T @ rays)


def _apply_homography(
    homography: NDArray[np.float64], xy: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the pixels (N, 2) that a homography gives, NaN where the depth is not positive.

    Written out, because a matrix product of this size would start the threads of BLAS.
    """
    x, y = np.ascontiguousarray(xy.T, np.float64)
    (a, b, c), (d, e, f), (g, h, i) = homography.tolist()
    depth = g * x + h * y + i
    inverse = 1 / np.where(depth > MIN_DEPTH, depth, np.nan)
    return np.stack([(a * x + b * y + c) * inverse, (d * x + e * y + f) * inverse], -1)


def resample(
    rgb: NDArray[np.uint8], affine: NDArray[np.float64], size: NDArray[np.int64]
) -> NDArray[np.uint8]:
    """Warp an image by ``affine`` (2, 3), in COLMAP pixels, to ``size`` (width, height).

    An image that becomes smaller is averaged over areas first, which avoids aliasing.
    """
    height, width = rgb.shape[:2]
    scale = np.linalg.norm(affine[:, :2], axis=0)
    if (scale < 1).any():
        small = np.maximum(np.round(np.array([width, height]) * np.minimum(scale, 1)), 1)
        small = small.astype(int)
        rgb = np.asarray(cv2.resize(rgb, small.tolist(), interpolation=cv2.INTER_AREA), np.uint8)
        affine = np.column_stack([affine[:, :2] * ([width, height] / small), affine[:, 2]])
    affine = opencv_affine(affine)
    return np.asarray(cv2.warpAffine(rgb, affine, size.tolist(), flags=cv2.INTER_LINEAR), np.uint8)


def opencv_affine(affine: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the affine map (2, 3) of COLMAP pixels for OpenCV, whose origin is a pixel centre."""
    shift = affine[:, 2] + affine[:, :2] @ [0.5, 0.5] - 0.5
    return np.column_stack([affine[:, :2], shift])
