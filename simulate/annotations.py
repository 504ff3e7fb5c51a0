"""Compute annotations over all frames of a scene: covisibility and pixel digests."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.covisibility import Covisibility, surface_points, visible_share
from objconnect.scene.bundle.frames import LAYERS
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.bundle.thermal import counts_path
from objconnect.scene.storage.digests import sha256
from objconnect.scene.storage.images import read_grey, read_rgb

# A frame's surface is sampled at a grid of 16 x 16 points. Shares are multiples of 1/256 in a frame
# without sky, and coarser in a frame with sky, whose points do not count.
_PER_SIDE = 16


def measure_covisibility(scene: Scene) -> Covisibility:
    """Measure the share of every frame's surface that each other frame sees, over all flights.

    Raises:
        InputError: a session is missing or damaged.
    """
    sessions = [scene.frames(session) for session in scene.sessions]
    cameras = [camera for frames in sessions for camera in frames.cameras]
    poses = np.concatenate([frames.cam_from_world for frames in sessions])
    points = [
        surface_points(camera, pose, depth, _PER_SIDE)
        for camera, pose, depth in zip(cameras, poses, _depths(scene), strict=True)
    ]
    overlap = visible_share(cameras, poses, np.stack(points), _depths(scene))
    return Covisibility(tuple(name for frames in sessions for name in frames.names), overlap)


def _depths(scene: Scene) -> Iterator[NDArray[np.float32]]:
    """Yield the depth of every frame, session by session."""
    for session in scene.sessions:
        with scene.layers(session) as layers:
            for k in range(len(scene.frames(session))):
                yield layers.read("depth", k)


def pixel_digests(scene: Scene) -> dict[str, dict[str, str]]:
    """Return the SHA-256 digests of the arrays of every frame, by the frame's name.

    The keys of a frame are "image", its layers and, in thermal sessions, "thermal" for the 16-bit
    counts.

    Compressed files differ between versions of libraries; pixels do not. A digest is computed over
    an array's bytes, row by row, little-endian.

    Raises:
        InputError: a photograph or a layer is damaged.
    """
    digests = {}
    for session in scene.sessions:
        frames = scene.frames(session)
        with scene.layers(session) as layers:
            for k, (name, camera) in enumerate(zip(frames.names, frames.cameras, strict=True)):
                arrays = {"image": read_rgb(scene.images_root / name, camera)}
                arrays |= {layer: layers.read(layer, k) for layer in LAYERS if layers.has(layer)}
                if scene.sessions[session].thermal is not None:
                    path = counts_path(scene.images_root, name)
                    arrays["thermal"] = read_grey(path, camera, bits=16)
                digests[name] = {key: _sha256(array) for key, array in arrays.items()}
    return digests


def _sha256(array: NDArray[np.generic]) -> str:
    little = array.astype(array.dtype.newbyteorder("<"), copy=False)
    return sha256(little)
