"""Training pairs from rendered scenes: crops of two frames, often of different conditions.

A condition is the season, light and weather of a session, which is one flight over a scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.learning.training.augment import augment
from objconnect.learning.training.crops import Crop, crop
from objconnect.learning.training.instances import objects_of
from objconnect.learning.training.keypoints import keypoints
from objconnect.learning.training.objects import PairObjects
from objconnect.learning.training.options import PAIRS, PairOptions
from objconnect.learning.training.pairs import (
    BORDER_PX,
    MIN_POINTS,
    Pair,
    Pinhole,
    cut_or_pad,
    perturb_transform,
)
from objconnect.scene.bundle.frames import DenseLayers
from objconnect.scene.bundle.manifest import SceneObject
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.views import looks_down, north_angle, rotate_north_up
from objconnect.scene.storage.images import read_rgb

# Offset between the object ids of two scenes, larger than the number of objects of a scene.
_IDS_PER_SCENE: Final = 1 << 17
# A point is visible in the other frame if its depth differs from the depth map there by at most
# this share.
_SAME_DEPTH: Final = 0.01

_Pairs = list[tuple[int, int]]


@dataclass(frozen=True)
class _Frame:
    """A frame of a scene.

    Attributes:
        image: file of the photograph.
        camera: camera of the photograph.
        cam_from_world: pose (4, 4).
        condition: condition of the session.
        session_key: index of the scene, and name of the session.
        index: index of the frame in the session.
    """

    image: Path
    camera: Pinhole
    cam_from_world: NDArray[np.float64]
    condition: str
    session_key: tuple[int, str]
    index: int


class RenderedPairs:
    """Draws pairs from finished scenes with depth. Implements ``PairSource``.

    Files are opened when the first pair is drawn, so that the object can be pickled for workers.

    Args:
        scenes: the scenes.
        size: side of the images of pairs, pixels.
        points: number of points of a pair.
        strength: strength of the photometric augmentation, 0 to 1.
        options: options of pairs.

    Raises:
        InputError: no frames overlap, or a frame has a distorted camera.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        size: int,
        points: int,
        strength: float,
        options: PairOptions = PAIRS,
    ) -> None:
        self._size, self._points, self._strength = size, points, strength
        self._options = options
        self._scenes = scenes
        self._frames: list[_Frame] = []
        # For each scene, pairs of frames of one condition, and pairs of two conditions.
        self._pairs: list[tuple[_Pairs, _Pairs]] = []
        for number, scene in enumerate(self._scenes):
            first = len(self._frames)
            self._frames += _frames(scene, number)
            same, cross = _pairs(scene, self._frames[first:], first, options)
            if same or cross:
                self._pairs.append((same or cross, cross or same))
        if not self._pairs:
            paths = ", ".join(str(scene.path) for scene in scenes)
            raise InputError(
                f"no two frames of one scene overlap by {options.min_overlap:.0%} in {paths}: "
                "render more frames"
            )
        self._open: dict[tuple[int, str], DenseLayers] | None = None
        self._by_id: dict[int, dict[int, SceneObject]] = {}

    def draw(self, rng: np.random.Generator) -> Pair:
        """See ``PairSource``."""
        while True:
            # Scenes are drawn uniformly, because a street has fewer pairs than a survey.
            same, cross = self._pairs[rng.integers(len(self._pairs))]
            pairs = cross if rng.uniform() < self._options.cross_share else same
            a, b = pairs[rng.integers(len(pairs))]
            if rng.uniform() < 0.5:
                a, b = b, a
            pair = self._make_pair(self._frames[a], self._frames[b], rng)
            if pair is not None:
                return pair

    def _depth(self, frame: _Frame) -> NDArray[np.float32]:
        return np.asarray(self._layers(frame).read("depth", frame.index))

    def _objects(self, frame: _Frame, crop_of_frame: Crop) -> PairObjects:
        """Return the objects in a crop of a frame."""
        number = frame.session_key[0]
        if number not in self._by_id:
            listed = self._scenes[number].objects.objects
            self._by_id[number] = {item.id: item for item in listed}
        instances = self._layers(frame).read("instance", frame.index)
        pose = crop_of_frame.crop_from_camera @ frame.cam_from_world
        first_id = number * _IDS_PER_SCENE
        return objects_of(instances, crop_of_frame, pose, self._by_id[number], first_id)

    def _layers(self, frame: _Frame) -> DenseLayers:
        """Return the layers of a frame's session; the first call opens all sessions."""
        if self._open is None:
            # The files stay open until the process ends.
            stack = ExitStack()
            self._open = {
                (number, session): stack.enter_context(scene.layers(session))
                for number, scene in enumerate(self._scenes)
                for session in scene.sessions
            }
            self._stack = stack
        return self._open[frame.session_key]

    def _make_pair(self, a: _Frame, b: _Frame, rng: np.random.Generator) -> Pair | None:
        """Return crops around a point that both frames show; None if they share too few points."""
        options = self._options
        photo_a, photo_b = read_rgb(a.image), read_rgb(b.image)
        depth_a, depth_b = self._depth(a), self._depth(b)
        b_from_a = b.cam_from_world @ np.linalg.inv(a.cam_from_world)
        xy_a = keypoints(photo_a, 24 * self._points, rng)
        points = a.camera.lift(xy_a, _depth_at(depth_a, xy_a))
        in_b = points @ b_from_a[:3, :3].T + b_from_a[:3, 3]
        in_front = (points[:, 2] > 0) & (in_b[:, 2] > 1)
        xy_a, points, in_b = xy_a[in_front], points[in_front], in_b[in_front]
        xy_b = b.camera.project(in_b)
        height, width = photo_b.shape[:2]
        shown = ((xy_b > 0) & (xy_b < [width, height])).all(1)
        seen_depth = _depth_at(depth_b, np.where(shown[:, None], xy_b, 0.5))
        shown &= np.abs(seen_depth - in_b[:, 2]) < _SAME_DEPTH * in_b[:, 2]
        xy_a, xy_b, points = xy_a[shown], xy_b[shown], points[shown]
        if len(points) < MIN_POINTS:
            return None
        zoom = np.exp(rng.uniform(*np.log(options.zoom)))
        anchor = rng.integers(len(points))
        jitter = rng.uniform(-0.25, 0.25, (2, 2)) * self._size / zoom
        relative_scale = np.exp(rng.normal(0, 0.08))
        if rng.uniform() < options.level_share:
            depth_ratio = float(in_b[shown][anchor, 2] / points[anchor, 2])
            relative_scale *= np.clip(depth_ratio * a.camera.focal[0] / b.camera.focal[0], 0.5, 2)
        # Two frames that look down are rotated by the same random multiple of 90 degrees, because
        # light comes from the north at sites south of the equator. Other frames keep the sky up.
        look_down = looks_down(a.cam_from_world[:3, :3]) and looks_down(b.cam_from_world[:3, :3])
        common_angle = np.pi / 2 * rng.integers(4) if look_down else 0.0
        angle_a = common_angle + north_angle(a.cam_from_world[:3, :3])
        angle_b = common_angle + north_angle(b.cam_from_world[:3, :3])
        angle_b += np.radians(rng.uniform(-options.heading_deg, options.heading_deg))
        zoom_b = zoom * relative_scale
        crop_a = crop(photo_a, a.camera, xy_a[anchor] + jitter[0], zoom, self._size, angle_a)
        crop_b = crop(photo_b, b.camera, xy_b[anchor] + jitter[1], zoom_b, self._size, angle_b)
        b_from_a = crop_b.crop_from_camera @ b_from_a @ crop_a.crop_from_camera.T
        points = points @ crop_a.crop_from_camera[:3, :3].T
        xy_a = crop_a.camera.project(points)
        xy_b = crop_b.camera.project(points @ b_from_a[:3, :3].T + b_from_a[:3, 3])
        border = BORDER_PX
        inside = crop_a.contains(xy_a, border) & crop_b.contains(xy_b, border)
        if inside.sum() < MIN_POINTS:
            return None
        depth = float(np.median(points[inside, 2]))
        valid, (points, xy_a, xy_b) = cut_or_pad(
            self._points, points[inside], xy_a[inside], xy_b[inside]
        )
        return Pair(
            augment(crop_a.image, rng, self._strength),
            augment(crop_b.image, rng, self._strength),
            crop_a.camera,
            crop_b.camera,
            b_from_a,
            perturb_transform(b_from_a, depth, rng),
            points,
            xy_a,
            xy_b,
            valid,
            (self._objects(a, crop_a), self._objects(b, crop_b)) if options.objects else None,
        )


def _frames(scene: Scene, number: int) -> list[_Frame]:
    """Return every frame of the scene with index ``number``, session by session."""
    frames = []
    for name, session in scene.sessions.items():
        stored = scene.frames(name)
        for index, (image, camera) in enumerate(zip(stored.names, stored.cameras, strict=True)):
            pinhole = _pinhole(camera, scene.images_root / image)
            pose = stored.cam_from_world[index]
            path = scene.images_root / image
            frames.append(_Frame(path, pinhole, pose, session.condition, (number, name), index))
    return frames


def _pinhole(camera: Camera, image: Path) -> Pinhole:
    if any(camera.distortion) or camera.is_fisheye:
        raise InputError(
            f"{image} was taken through a lens with distortion: train on photographs of a pinhole "
            "camera"
        )
    return Pinhole(np.array(camera.focal), np.array(camera.principal))


def _pairs(
    scene: Scene, frames: Sequence[_Frame], first: int, options: PairOptions
) -> tuple[_Pairs, _Pairs]:
    """Return the pairs of frames of a scene that overlap and have about the same attitude.

    Args:
        scene: the scene.
        frames: all frames of the scene.
        first: index of the scene's first frame among the frames of all scenes.
        options: the least overlap and the largest angle of a pair.

    Returns:
        Pairs of indices (a < b) of frames of one condition, and of frames of two conditions.
    """
    names = [str(frame.image.relative_to(scene.images_root)) for frame in frames]
    overlap = scene.covisibility.select(names).mutual
    rotations = np.stack([rotate_north_up(frame.cam_from_world[:3, :3]) for frame in frames])
    traces = np.einsum("aij,bij->ab", rotations, rotations)
    angle = np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1)))
    is_pair = (overlap >= options.min_overlap) & (angle <= options.max_turn_deg)
    same: _Pairs = []
    cross: _Pairs = []
    for a, b in np.argwhere(np.triu(is_pair, 1)).tolist():
        differ = frames[a].condition != frames[b].condition
        (cross if differ else same).append((a + first, b + first))
    return same, cross


def _depth_at(depth: NDArray[np.float32], xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the depths (N,) of the pixels that contain ``xy`` (N, 2)."""
    height, width = depth.shape
    column = np.clip(xy[:, 0].astype(int), 0, width - 1)
    row = np.clip(xy[:, 1].astype(int), 0, height - 1)
    return np.asarray(depth[row, column], np.float64)
