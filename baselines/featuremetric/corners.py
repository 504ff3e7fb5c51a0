"""Points where photographs of a map show corners, placed by the photographs beside them.

A sparse map has its points where SIFT found texture, in one season: most lie on plain ground, and
snow hides them. What stays to be seen is corners of roofs, roads, walls and crowns. Their pixels
are swept along their rays (Collins, "A space-sweep approach to true multi-image matching", CVPR
1996), and stand where the neighbours, whose poses are known, show the same.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import h5py
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import grid_sample

from baselines.views import view
from scene.camera import Camera
from scene.errors import HDF5_DAMAGE, InputError
from scene.files import written_whole
from scene.hdf5 import array
from scene.images import read_rgb
from scene.pose import Pose
from scene.progress import progress_bar
from scene.sparse_map import SparseMap

# Pixels between corners, and least strength of them as a share of the strongest.
_APART: Final = 4.0
_QUALITY: Final = 1e-3
_BORDER: Final = 8.0
# A window of so many by so many samples, a pixel and a half apart, is compared.
_WINDOW: Final = 7
_STEP: Final = 1.5
_NEIGHBOURS: Final = 4
_LEAST_SHARED: Final = 20
# Rays should cross at about this angle: flatter ones say little of depth, steeper ones look unlike.
_BEST_ANGLE: Final = math.radians(15)
# Beyond the depths of the map's own points by this share, steps of a pixel, at most so many.
_BEYOND: Final = 0.1
_MOST_DEPTHS: Final = 256
# Agreement (normalised cross-correlation) that two photographs must reach, and by how much any
# other depth must fall behind.
_AGREE: Final = 0.75
_BETTER: Final = 0.05
_APART_STEPS: Final = 2
_HELD: Final = 12
# Small enough that windows stay in the processor's cache.
_AT_ONCE: Final = 128


@dataclass(frozen=True)
class Corners:
    """Corners of one photograph.

    Attributes:
        xy: (N, 2) pixels.
        xyz: (N, 3) world metres.
    """

    xy: NDArray[np.float64]
    xyz: NDArray[np.float64]


class _Look(NamedTuple):
    """Grey values (H, W) of a photograph made smaller, its camera, its pose, and the way back to
    the pixels of the photograph."""

    grey: Tensor
    camera: Camera
    pose: Pose
    in_photograph: Callable[[NDArray[np.float64]], NDArray[np.float64]]


class CornerFinder:
    """Finds the corners of a map's photographs, one photograph after the other.

    Args:
        sparse_map: whose photographs, and points that say who sees the same.
        images: folder of the photographs.
        most: corners of a photograph.
        longest: photographs with a longer side (px) are made smaller.
    """

    def __init__(self, sparse_map: SparseMap, images: Path, most: int, longest: int) -> None:
        self._map = sparse_map
        self._images = images
        self._most = most
        self._longest = longest
        self._looks: OrderedDict[str, _Look] = OrderedDict()
        self._rows = {
            name: np.unique(image.point_rows[image.point_rows >= 0])
            for name, image in sparse_map.images.items()
        }

    @torch.inference_mode()
    def __call__(self, name: str) -> Corners:
        """Of one photograph; none where it has too few neighbours.

        Raises:
            InputError: a photograph is missing or damaged.
        """
        neighbours = self._beside(name)
        nothing = Corners(np.empty((0, 2)), np.empty((0, 3)))
        if len(neighbours) < 2:
            return nothing
        look = self._look(name)
        xy = _corners(look.grey, self._most)
        if not len(xy):
            return nothing
        depths = self._depths(name, look.camera, neighbours).float()
        others = [self._look(each) for each in neighbours]
        parts = [
            _swept(look, part, others, depths)
            for part in torch.split(torch.from_numpy(xy), _AT_ONCE)
        ]
        xyz = torch.cat([points for points, _ in parts]).numpy()
        good = torch.cat([sure for _, sure in parts]).numpy()
        return Corners(look.in_photograph(xy[good]), xyz[good])

    def _beside(self, name: str) -> list[str]:
        """Photographs of the same, whose rays cross this one's well and from different sides."""
        own, here = self._map.images[name], self._rows[name]
        centre = own.pose.centre().numpy()
        middle = np.median(self._map.xyz[here], axis=0) if len(here) else centre
        distance = max(float(np.linalg.norm(middle - centre)), 1e-9)
        scores, sides = {}, {}
        for other, rows in self._rows.items():
            shared = len(np.intersect1d(here, rows, assume_unique=True)) if other != name else 0
            if shared < _LEAST_SHARED:
                continue
            baseline = self._map.images[other].pose.centre().numpy() - centre
            angle = math.atan2(float(np.linalg.norm(baseline)), distance)
            scores[other] = shared * math.exp(-((math.log(max(angle, 1e-6) / _BEST_ANGLE)) ** 2))
            sides[other] = baseline / max(float(np.linalg.norm(baseline)), 1e-9)
        chosen: list[str] = []
        while scores and len(chosen) < _NEIGHBOURS:
            best = max(
                scores, key=lambda n: scores[n] * _novel(sides[n], [sides[c] for c in chosen])
            )
            chosen.append(best)
            del scores[best]
        return chosen

    def _depths(self, name: str, camera: Camera, neighbours: Sequence[str]) -> Tensor:
        """Inverse depths to try, (D,): a pixel apart in the neighbour that is farthest away."""
        pose = self._map.images[name].pose
        z = pose.transform(torch.from_numpy(self._map.xyz[self._rows[name]]))[:, 2]
        near, far = (float(q) for q in z[z > 0].quantile(z.new_tensor([0.005, 0.995])))
        centre = pose.centre()
        reach = max(float((self._map.images[n].pose.centre() - centre).norm()) for n in neighbours)
        low, high = 1 / (far * (1 + _BEYOND)), 1 / (near * (1 - _BEYOND))
        count = math.ceil(max(camera.focal) * reach * (high - low)) + 1
        return torch.linspace(low, high, min(max(count, 8), _MOST_DEPTHS), dtype=torch.float64)

    def _look(self, name: str) -> _Look:
        """At a photograph; the last few are kept."""
        if name not in self._looks:
            image = self._map.images[name]
            rgb = read_rgb(self._images / name, image.camera)
            scale = min(1.0, self._longest / max(image.camera.width, image.camera.height))
            small = view(rgb, image.camera, 0.0, scale)
            grey = cv2.cvtColor(np.ascontiguousarray(small.picture), cv2.COLOR_RGB2GRAY)
            values = torch.from_numpy(grey.astype(np.float32))
            self._looks[name] = _Look(values, small.camera, image.pose, small.in_photograph)
            while len(self._looks) > _HELD:
                self._looks.popitem(last=False)
        self._looks.move_to_end(name)
        return self._looks[name]


def all_corners(
    sparse_map: SparseMap, images: Path, most: int, longest: int, path: Path
) -> list[NDArray[np.float64]]:
    """Places (N, 3) of the corners of every photograph of a map, kept in a file for every method.

    Args:
        sparse_map: whose photographs.
        images: folder of the photographs.
        most: corners of a photograph.
        longest: see ``CornerFinder``.
        path: of the file.

    Raises:
        InputError: a photograph is missing or damaged, or the file is.
    """
    if not path.is_file():
        find = CornerFinder(sparse_map, images, most, longest)
        found = []
        with progress_bar("corners of the map", len(sparse_map.names)) as advance:
            for done, name in enumerate(sparse_map.names, 1):
                found.append(find(name).xyz)
                advance(done)
        with written_whole(path) as partial, h5py.File(partial, "w") as file:
            file["xyz"] = np.concatenate([np.empty((0, 3)), *found])
            file["ends"] = np.cumsum([len(xyz) for xyz in found])
    try:
        with h5py.File(path) as file:
            xyz, ends = array(file, "xyz"), array(file, "ends")
            return np.split(xyz, ends[:-1])
    except HDF5_DAMAGE as error:
        raise InputError(f"{path} is damaged ({error}): delete it") from None


def _novel(side: NDArray[np.float64], chosen: Sequence[NDArray[np.float64]]) -> float:
    """1 for a direction across those chosen, less for one along them."""
    return 1.1 - max((abs(float(side @ other)) for other in chosen), default=0.0)


def _corners(grey: Tensor, most: int) -> NDArray[np.float64]:
    """Shi and Tomasi's corners, (N, 2) pixels, the strongest first."""
    smooth = cv2.GaussianBlur(grey.numpy(), (0, 0), 1.0)
    found = cv2.goodFeaturesToTrack(smooth, most, _QUALITY, _APART)
    if found is None:
        return np.empty((0, 2))
    # OpenCV counts from the first pixel's centre.
    xy = found[:, 0].astype(np.float64) + 0.5
    size = np.array(grey.shape[::-1])
    return np.asarray(xy[((xy >= _BORDER) & (xy <= size - _BORDER)).all(1)])


def _swept(
    look: _Look, xy: Tensor, others: Sequence[_Look], depths: Tensor
) -> tuple[Tensor, Tensor]:
    """Where pixels (N, 2) stand in the world, (N, 3), and which are sure, (N,)."""
    unit = (torch.arange(_WINDOW, dtype=xy.dtype) - _WINDOW // 2) * _STEP
    window = torch.stack(torch.meshgrid(unit, unit, indexing="xy"), -1).flatten(0, 1)
    # Rays through the corner and one pixel beside and below it: windows move with these.
    three = xy[:, None] + xy.new_tensor([[0, 0], [1, 0], [0, 1]])
    rays, usable = look.camera.unproject(three.flatten(0, 1))
    rays = rays.view(*three.shape[:2], 3).float()
    own = _normalised(_looked_up(look.grey, xy[:, None] + window))
    agreement = torch.stack(
        [_agreement(look, rays, own, window.float(), depths, other) for other in others],
        -1,
    )
    # The better half: the others may not see it.
    best_two = agreement.topk(2, -1).values
    score = best_two.mean(-1)
    top, index = score.max(1)
    apart = (torch.arange(len(depths)) - index[:, None]).abs() > _APART_STEPS
    rival = torch.where(apart, score, -1).amax(1)
    inner = index.clamp(1, len(depths) - 2)
    before, at, after = (score.gather(1, (inner + k)[:, None])[:, 0] for k in (-1, 0, 1))
    curve = (before - 2 * at + after).clamp(max=-1e-6)
    offset = (0.5 * (before - after) / curve).clamp(-0.5, 0.5)
    second = best_two.gather(1, index[:, None, None].expand(-1, 1, 2))[:, 0, 1]
    sure = (second > _AGREE) & (top > rival + _BETTER) & (index == inner)
    sure &= usable.view(three.shape[:2]).all(1)
    inverse = depths[inner] + offset * (depths[1] - depths[0])
    in_camera = rays[:, 0].double() / inverse[:, None].double()
    return look.pose.inverse().transform(in_camera), sure


def _agreement(
    look: _Look, rays: Tensor, own: Tensor, window: Tensor, depths: Tensor, other: _Look
) -> Tensor:
    """Correlation of windows (N, P) with what another photograph shows there, (N, D)."""
    relative = (other.pose @ look.pose.inverse()).to(dtype=rays.dtype)
    in_camera = rays[:, None] / depths[:, None, None] @ relative.rotation.T + relative.translation
    shape = in_camera.shape[:3]
    projected = other.camera.project(in_camera.flatten(0, 2))
    inside = projected.valid & other.camera.contains(projected.xy, _BORDER)
    corner, right, below = projected.xy.view(*shape, 2).unbind(2)
    across = torch.stack([right - corner, below - corner], -2)
    theirs = _normalised(_looked_up(other.grey, corner[:, :, None] + window @ across))
    found = torch.einsum("np,ndp->nd", own, theirs)
    return torch.where(inside.view(shape).all(-1), found, -1)


def _looked_up(grey: Tensor, xy: Tensor) -> Tensor:
    """Values of a picture (H, W) at pixels (..., 2)."""
    size = xy.new_tensor([grey.shape[1], grey.shape[0]])
    grid = (2 * xy / size - 1).float().view(1, -1, xy.shape[-2], 2)
    return grid_sample(grey[None, None], grid, align_corners=False).view(xy.shape[:-1])


def _normalised(windows: Tensor) -> Tensor:
    """Windows (..., P) of mean zero and length one; plain ones are zero."""
    centred = windows - windows.mean(-1, keepdim=True)
    length = centred.norm(dim=-1, keepdim=True)
    return torch.where(length > windows.shape[-1] ** 0.5, centred / length.clamp_min(1e-6), 0)
