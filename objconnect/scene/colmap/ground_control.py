"""Adjustment of a model to surveyed ground control points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pycolmap
from numpy.typing import NDArray

from objconnect.scene.colmap.models import write_model
from objconnect.scene.colmap.structure_from_motion import RefinedLenses, configure_adjustment
from objconnect.scene.geometry.robust import CAUCHY_SCALE
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.photographs import Photograph
from objconnect.scene.maps.sparse_map import SparseMap

# COLMAP receives a surveyed position as observations by three distant cameras of known pose, one
# along each axis. Two of them measure each coordinate, each with half of the weight.
_CAMERAS_PER_COORDINATE: Final = 2
_DISTANCE_M: Final = 1000.0
_CAM_FROM_WORLD_ROTATIONS: Final = np.stack(
    [np.eye(3), np.roll(np.eye(3), 1, 0), np.roll(np.eye(3), 2, 0)]
)


@dataclass(frozen=True)
class SurveyedPoint:
    """A surveyed point with its marks in photographs.

    Attributes:
        xyz: surveyed position, (3,) world metres.
        sigma: its standard deviation per axis, metres.
        marks: (2,) COLMAP pixels by name of the photograph.
    """

    xyz: NDArray[np.float64]
    sigma: float
    marks: Mapping[str, NDArray[np.float64]]


def adjust_to_points(
    model: Path,
    photographs: Sequence[Photograph],
    world_from_model: NDArray[np.float64],
    points: Sequence[SurveyedPoint],
    refined: RefinedLenses,
    out: Path,
) -> SparseMap:
    """Transform a model to the world and adjust it to keypoints and surveyed points jointly.

    It adjusts poses, points and lenses with a robust loss. These errors have the same weight: a
    mark off by one pixel, a keypoint off by one pixel, and a surveyed coordinate off by one sigma.

    Args:
        model: folder of a model of ``map_photographs``.
        photographs: photographs of the model; others are ignored.
        world_from_model: similarity transform, (3, 4): scale times rotation, and translation.
        points: at least three points that are not collinear, each marked in at least two
            photographs of the model.
        refined: lens parameters to adjust.
        out: existing folder for the adjusted model.
    """
    native = pycolmap.Reconstruction(model)
    native.transform(pycolmap.Sim3d(np.ascontiguousarray(world_from_model)))
    config, options = configure_adjustment(native, photographs, refined)
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = CAUCHY_SCALE
    keypoints = {image_id: image.num_points2D() for image_id, image in native.images.items()}
    ids = {image.name: image_id for image_id, image in native.images.items()}
    added, frames = [], []
    for point in points:
        track = []
        for name, xy in point.marks.items():
            track.append(_add_observation(native, ids[name], xy))
        for image_id in _add_distant_cameras(native, point):
            config.add_image(image_id)
            config.set_constant_cam_intrinsics(native.image(image_id).camera_id)
            config.set_constant_rig_from_world_pose(native.image(image_id).frame_id)
            frames.append(native.image(image_id).frame_id)
            track.append(_add_observation(native, image_id, np.zeros(2)))
        added.append(native.add_point3D(point.xyz, pycolmap.Track(track)))
    pycolmap.create_default_bundle_adjuster(options, config, native).solve()
    for point_id in added:
        native.delete_point3D(point_id)
    for frame_id in frames:
        native.deregister_frame(frame_id)
    for image_id, count in keypoints.items():
        del native.images[image_id].points2D[count:]
    native.update_point_3d_errors()
    write_model(native, out)
    return read_model(out)


def _add_observation(
    native: pycolmap.Reconstruction, image_id: int, xy: NDArray[np.float64]
) -> pycolmap.TrackElement:
    """Add a keypoint to an image and return it as an element of a track."""
    keypoints = native.images[image_id].points2D
    keypoints.append(pycolmap.Point2D(xy))
    return pycolmap.TrackElement(image_id, len(keypoints) - 1)


def _add_distant_cameras(native: pycolmap.Reconstruction, point: SurveyedPoint) -> Iterator[int]:
    """Add cameras that observe a surveyed position at pixel (0, 0); yield their identifiers."""
    focal = _DISTANCE_M / (point.sigma * np.sqrt(_CAMERAS_PER_COORDINATE))
    for axes in _CAM_FROM_WORLD_ROTATIONS:
        camera_id = max(native.cameras) + 1
        camera = pycolmap.Camera(
            model="SIMPLE_PINHOLE", width=1, height=1, params=[focal, 0, 0], camera_id=camera_id
        )
        native.add_camera_with_trivial_rig(camera)
        centre = point.xyz - _DISTANCE_M * axes[2]
        pose = pycolmap.Rigid3d(np.column_stack([axes, -axes @ centre]))
        image_id = max(native.images) + 1
        view = pycolmap.Image(name=f"point/{image_id}", camera_id=camera_id, image_id=image_id)
        native.add_image_with_trivial_frame(view, pose)
        yield image_id
