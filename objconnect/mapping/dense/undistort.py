"""Undistort photographs and maps for stereo."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.images import read_rgb

# The focal length grows by this factor per step, up to a limit, until the pinhole's picture lies
# inside the photograph.
_GROWTH = 1.02
_MAX_GROWTH = 8.0
# Quality of the JPEG files that COLMAP and other programs read.
_QUALITY = 98


def pinhole_of(camera: Camera, size: int) -> Camera:
    """Return a PINHOLE camera whose field of view lies completely inside that of ``camera``.

    Args:
        camera: the camera of photographs.
        size: longest side of the picture, pixels; pictures are never enlarged.

    Raises:
        InputError: no such pinhole exists, because the principal point or the distortion is wrong.
    """
    (fx, fy), (cx, cy) = camera.focal, camera.principal
    zoom = 1.0
    while zoom < _MAX_GROWTH:
        pinhole = Camera("PINHOLE", camera.width, camera.height, (fx * zoom, fy * zoom, cx, cy))
        if not any(camera.distortion) and not camera.is_fisheye:
            break
        grid = pinhole.pixel_grid()
        border = torch.cat([grid[0], grid[-1], grid[:, 0], grid[:, -1]])
        projected = camera.project(pinhole.unproject(border)[0])
        if bool((projected.valid & camera.contains(projected.xy, border=0.5)).all()):
            break
        zoom *= _GROWTH
    else:
        raise InputError(f"camera {camera} cannot be undistorted: check its principal point and "
                         "distortion")  # fmt: skip
    scale = min(1.0, size / max(camera.width, camera.height))
    return pinhole.resize(round(camera.width * scale), round(camera.height * scale))


def undistort_map(sparse_map: SparseMap, cameras: Mapping[Camera, Camera]) -> SparseMap:
    """Return the map with undistorted cameras; ``cameras`` maps distorted to undistorted ones."""

    def undistort_image(image: MapImage) -> MapImage:
        camera = cameras[image.camera]
        rays, _ = image.camera.unproject(torch.from_numpy(image.xy))
        return replace(image, camera=camera, xy=camera.project(rays).xy.numpy())

    return replace(
        sparse_map,
        images={name: undistort_image(image) for name, image in sparse_map.images.items()},
    )


def write_undistorted(photograph: Path, camera: Camera, pinhole: Camera, out: Path) -> None:
    """Undistort a photograph and write it; copy it if it has no distortion and keeps its size.

    Raises:
        InputError: the photograph is missing, damaged or not of its camera's size, or cannot be
            written.
    """
    rgb = read_rgb(photograph, camera)
    with atomic_write(out) as partial:
        if (camera.calibration == pinhole.calibration).all() and not any(camera.distortion):
            partial.write_bytes(photograph.read_bytes())
            return
        kind = "PNG" if out.suffix.lower() == ".png" else "JPEG"
        pixels = Image.fromarray(_remap(rgb, camera, pinhole))
        pixels.save(partial, kind, quality=_QUALITY, subsampling=0)


def _remap(rgb: NDArray[np.uint8], camera: Camera, pinhole: Camera) -> NDArray[np.uint8]:
    """Undistort a photograph at its own resolution, then reduce it by averaging."""
    full = pinhole.resize(camera.width, camera.height)
    rays, _ = full.unproject(full.pixel_grid())
    # OpenCV counts pixels from the centre of the first pixel.
    x, y = (camera.project(rays).xy - 0.5).float().unbind(-1)
    undistorted = cv2.remap(
        rgb, x.numpy(), y.numpy(), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT
    )
    size = (pinhole.width, pinhole.height)
    return np.asarray(cv2.resize(undistorted, size, interpolation=cv2.INTER_AREA), np.uint8)
