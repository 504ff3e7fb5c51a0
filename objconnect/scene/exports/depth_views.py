"""Photographs of a scene with exact depth, or with depth estimated by ``dense``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.frames import Frames
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.depth_files import read_array
from objconnect.scene.storage.images import read_rgb

DENSE: Final = "dense"
"""The folder of a scene with the results of ``dense``, a workspace of COLMAP."""


@dataclass(frozen=True)
class DepthView:
    """A photograph with depth; both are read on demand.

    Attributes:
        camera: camera of the photograph and of its depth.
        cam_from_world: (4, 4).
        depth: reads the planar depth (H, W), metres; 0 where unknown.
        rgb: reads the photograph (H, W, 3).
    """

    camera: Camera
    cam_from_world: NDArray[np.float64]
    depth: Callable[[], NDArray[np.float32]]
    rgb: Callable[[], NDArray[np.uint8]]

    def points(self, step: int = 1) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the surface points of every ``step``-th row and column of pixels.

        Returns:
            World points (N, 3) of the pixels with depth, and the mask (h, w) of these pixels.
        """
        import torch

        depth = self.depth()[::step, ::step].astype(np.float64)
        rays, valid = self.camera.unproject(self.camera.pixel_grid()[::step, ::step])
        mask = (depth > 0) & np.isfinite(depth) & valid.numpy()
        local = rays[torch.from_numpy(mask)].numpy() * depth[mask][:, None]
        return (local - self.cam_from_world[:3, 3]) @ self.cam_from_world[:3, :3], mask


def depth_views(scene: Scene, sessions: Mapping[str, Frames]) -> list[DepthView]:
    """Return the map photographs of the sessions, or all photographs if none is in the map.

    Exact depth is preferred to estimated depth.

    Raises:
        InputError: there is no depth, or the results of ``dense`` are damaged.
    """
    map_names = set(scene.splits.map)
    has_map_photographs = any(
        name in map_names for frames in sessions.values() for name in frames.names
    )
    views = []
    for session, frames in sessions.items():
        with scene.layers(session) as layers:
            if not layers.has("depth"):
                continue
        for k, name in enumerate(frames.names):
            if name in map_names or not has_map_photographs:
                depth = partial(_read_exact, scene, session, k)
                rgb = partial(read_rgb, scene.images_root / name, frames.cameras[k])
                views.append(DepthView(frames.cameras[k], frames.cam_from_world[k], depth, rgb))
    views = views or _read_estimated_views(scene, {n for f in sessions.values() for n in f.names})
    if not views:
        raise InputError(
            f"these sessions of {scene.path} have no depth: run 'objconnect dense {scene.path}'"
        )
    return views


def _read_exact(scene: Scene, session: str, index: int) -> NDArray[np.float32]:
    with scene.layers(session) as layers:
        return np.asarray(layers.read("depth", index), np.float32)


def _read_estimated_views(scene: Scene, names: set[str]) -> list[DepthView]:
    workspace = scene.path / DENSE
    if not workspace.is_dir():
        return []
    views = []
    for name, image in read_model(workspace / "sparse").images.items():
        file = workspace / "stereo" / "depth_maps" / f"{name}.geometric.bin"
        if name in names and file.is_file():
            depth = partial(_read_estimate, file, image.camera)
            rgb = partial(read_rgb, workspace / "images" / name, image.camera)
            views.append(DepthView(image.camera, image.cam_from_world, depth, rgb))
    return views


def _read_estimate(file: Path, camera: Camera) -> NDArray[np.float32]:
    depth: NDArray[np.float32] = read_array(file, 1)[0]
    if depth.shape != (camera.height, camera.width):
        raise InputError(
            f"{file} holds {depth.shape[1]} x {depth.shape[0]} pixels, its camera has "
            f"{camera.width} x {camera.height}: run 'objconnect dense' again"
        )
    return depth
