"""Writing and editing of COLMAP's binary models."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from objconnect.scene.colmap.native import native_camera, native_pose
from objconnect.scene.errors import InputError
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.photographs import Photograph, PosedImage
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.files import require_disk_space


def make_model(
    images: Sequence[PosedImage], keypoints: Mapping[str, NDArray[Any]]
) -> tuple[pycolmap.Reconstruction, dict[str, int]]:
    """Make a model of keypoints (K, 2) and poses without points.

    Returns:
        The model, and the identifiers of the images by name.
    """
    camera_ids = {camera: k for k, camera in enumerate(dict.fromkeys(i.camera for i in images), 1)}
    cameras = [native_camera(camera, camera_id) for camera, camera_id in camera_ids.items()]
    model, ids = empty_model(cameras), {image.name: k for k, image in enumerate(images, 1)}
    for image in images:
        native = pycolmap.Image(
            name=image.name,
            keypoints=keypoints[image.name].astype(np.float64),
            camera_id=camera_ids[image.camera],
            image_id=ids[image.name],
        )
        model.add_image_with_trivial_frame(native, native_pose(image.cam_from_world))
    return model, ids


def extend_model(
    images: Sequence[PosedImage],
    keypoints: Mapping[str, NDArray[Any]],
    photographs: Sequence[Photograph],
) -> tuple[pycolmap.Reconstruction, dict[str, int]]:
    """Make a model of posed images and of photographs without a pose.

    Calibrated photographs and posed images with equal calibrations share one camera. Other
    photographs share one camera per lens.

    Args:
        images: posed images; identifiers are those of ``make_model``.
        keypoints: keypoints (K, 2) of the posed images.
        photographs: photographs to register.

    Returns:
        The model, and the identifiers of the images by name.
    """
    model, ids = make_model(images, keypoints)
    camera_ids: dict[object, int] = {}
    for image in images:
        camera_ids[image.camera] = model.image(ids[image.name]).camera_id
    for photograph in photographs:
        key = photograph.camera if photograph.calibrated else photograph.lens
        if key not in camera_ids:
            camera_ids[key] = len(model.cameras) + 1
            native = native_camera(photograph.camera, camera_ids[key])
            native.has_prior_focal_length = photograph.focal_known
            model.add_camera_with_trivial_rig(native)
        ids[photograph.name] = len(ids) + 1
        model.add_image_with_trivial_frame(
            pycolmap.Image(
                name=photograph.name, camera_id=camera_ids[key], image_id=ids[photograph.name]
            )
        )
    return model, ids


def empty_model(cameras: Iterable[pycolmap.Camera]) -> pycolmap.Reconstruction:
    """Make a model of cameras only."""
    model = pycolmap.Reconstruction()
    for camera in cameras:
        model.add_camera_with_trivial_rig(camera)
    return model


def write_model(model: pycolmap.Reconstruction, out: Path) -> None:
    """Write a model after checking the disk space, because COLMAP does not report a full disk."""
    keypoints = sum(image.num_points2D() for image in model.images.values())
    # A keypoint takes 24 bytes, a point 51, and an observation 8; the rest is a margin.
    require_disk_space(out, (1 << 20) + 40 * keypoints + 100 * model.num_points3D())
    model.write(out)


def _read_checked_model(folder: Path) -> pycolmap.Reconstruction:
    """Read a model with COLMAP after checking it: COLMAP ends the process on a damaged one."""
    read_model(folder)
    return pycolmap.Reconstruction(folder)


def write_with_poses(images: Sequence[PosedImage], sparse_map: SparseMap | None, out: Path) -> None:
    """Write images with their poses as a binary model.

    Args:
        images: images of the model, in the order of their identifiers.
        sparse_map: map that provides the images' keypoints and the points they observe; None writes
            neither.
        out: existing folder for the model.
    """
    map_images = sparse_map.images if sparse_map is not None else {}
    empty = np.zeros((0, 2))
    keypoints = {i.name: map_images[i.name].xy if i.name in map_images else empty for i in images}
    model, ids = make_model(images, keypoints)
    if sparse_map is not None:
        add_map_points(model, {n: k for n, k in ids.items() if n in map_images}, sparse_map)
        model.update_point_3d_errors()
    write_model(model, out)


def add_map_points(
    model: pycolmap.Reconstruction, ids: Mapping[str, int], sparse_map: SparseMap
) -> None:
    """Add the points of a map to a model of its images, in order.

    Args:
        model: model with the images of the map and without points.
        ids: identifiers in the model of the map images whose observations are added.
        sparse_map: the map.
    """
    tracks: dict[int, list[pycolmap.TrackElement]] = {}
    for name, image_id in ids.items():
        rows = sparse_map.images[name].point_rows
        for keypoint in np.flatnonzero(rows >= 0).tolist():
            element = pycolmap.TrackElement(image_id, keypoint)
            tracks.setdefault(int(rows[keypoint]), []).append(element)
    for row, elements in sorted(tracks.items()):
        model.add_point3D(sparse_map.xyz[row], pycolmap.Track(elements), sparse_map.rgb[row])


@dataclass(frozen=True)
class NewPoint:
    """A point to add to a model.

    Attributes:
        xyz: (3,) world metres.
        rgb: (3,) uint8.
        xy: observations, (2,) COLMAP pixels by name of the image; no two points share an
            observation.
    """

    xyz: NDArray[np.float64]
    rgb: NDArray[np.uint8]
    xy: Mapping[str, NDArray[np.float64]]


def add_points(model: Path, points: Sequence[NewPoint], out: Path) -> list[int]:
    """Write a model with additional points; existing ones keep identifiers, order and values.

    Args:
        model: folder of a binary model.
        points: points to add; their observations are appended to the keypoints of the images.
        out: existing folder.

    Returns:
        COLMAP's identifiers of the new points.

    Raises:
        InputError: the model is damaged, an observation is in an image it does not have, or a point
            lies behind an image that observes it.
    """
    native = _read_checked_model(model)
    images = {image.name: image for image in native.images.values()}
    ids = []
    for point in points:
        track = []
        for name, xy in point.xy.items():
            if name not in images:
                raise InputError(f"model {model} has no image {name!r}")
            keypoints = images[name].points2D
            track.append(pycolmap.TrackElement(images[name].image_id, len(keypoints)))
            keypoints.append(pycolmap.Point2D(xy))
        ids.append(int(native.add_point3D(point.xyz, pycolmap.Track(track), point.rgb)))
        native.points3D[ids[-1]].error = _mean_error(native, ids[-1])
    native.write(out)
    return ids


def _mean_error(model: pycolmap.Reconstruction, point_id: int) -> float:
    """Return the mean reprojection error of a point (px), which COLMAP stores with each point."""
    point = model.points3D[point_id]
    errors = []
    for element in point.track.elements:
        image = model.images[element.image_id]
        projected = image.project_point(point.xyz)
        if projected is None:
            raise InputError(f"point {point_id} lies behind image {image.name}, which observes it")
        errors.append(np.linalg.norm(projected - image.points2D[element.point2D_idx].xy))
    return float(np.mean(errors))


def remove_points(model: Path, ids: Sequence[int], out: Path) -> None:
    """Undo ``add_points``; the resulting files equal the original ones byte for byte.

    Args:
        model: folder of a binary model.
        ids: identifiers from ``add_points``; their keypoints are the last of their images.
        out: existing folder.

    Raises:
        InputError: the model is damaged, lacks a point, or was changed since ``add_points``.
    """
    native = _read_checked_model(model)
    added: dict[int, set[int]] = {}
    for point_id in ids:
        if point_id not in native.points3D:
            raise InputError(f"model {model} has no point {point_id}")
        for element in native.points3D[point_id].track.elements:
            added.setdefault(element.image_id, set()).add(element.point2D_idx)
    for point_id in ids:
        native.delete_point3D(point_id)
    for image_id, keypoints in added.items():
        image = native.images[image_id]
        remaining = image.num_points2D() - len(keypoints)
        if min(keypoints) != remaining:
            raise InputError(
                f"the keypoints of points added to {model} are not the last of image {image.name}: "
                "the model was changed since; build the map again"
            )
        del image.points2D[remaining:]
    native.write(out)


def lens_ids(photographs: Sequence[Photograph]) -> dict[str, int]:
    """Return COLMAP's camera identifier of each lens, in order of first appearance."""
    return {lens: k for k, lens in enumerate(dict.fromkeys(p.lens for p in photographs), 1)}
