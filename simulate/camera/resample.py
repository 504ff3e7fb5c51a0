"""Resample Blender's pinhole picture to the photograph of a camera with distortion.

All layers are resampled at the same positions, so that they stay aligned. The module runs in
Blender's process and needs only numpy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Cast = Callable[[int, Array], Array]
"""A function that casts rays (M, 2), x/z and y/z in the camera frame, at the object with an id.

Id 0 is the ground. The result is the planar depth (M,) of each first hit, infinite if a ray misses.
"""

# Interpolated inverse depth is exact on a plane. Where it deviates by more than this (metres of
# depth over one pixel), the surface is not a plane and the ray is cast.
_FLAT_M = 2e-4
_SINGLE_SAMPLE_GROWTH = (
    0.2  # up to this relative increase of pixel size, one sample per pixel is enough
)


def resample(
    layers: dict[str, NDArray[Any]], xy: Array, rays: Array, cast: Cast, boxes: dict[int, Array]
) -> dict[str, NDArray[Any]]:
    """Resample the layers of a pinhole picture at other pixel centres.

    The depth is exact. On planes it is interpolated. Elsewhere (at edges and in foliage, 10 to 50 %
    of a picture) rays are cast at the objects that neighbouring pixels see. Casting all rays at all
    objects would take 83 microseconds per ray and 22 s for a picture of 512 x 512; casting these
    rays takes about a second.

    Args:
        layers: rgb, depth, instance and normal as rendered, (h, w, ...).
        xy: (H, W, 2) position of each pixel centre of the photograph in the layers, COLMAP pixels,
            at least 3 pixels from their edges.
        rays: (H, W, 2) x/z and y/z of the same pixel centres.
        cast: casts rays at the objects of the world.
        boxes: boxes (left, top, right, bottom) by id, in the coordinates of rays, around objects
            that may lie partly between pixel centres because they are small in the picture.

    Returns:
        The same layers, (H, W, ...).
    """
    depth, instance = _surface(layers["depth"], layers["instance"], xy, rays, cast)
    for object_id, box in boxes.items():
        inside = ((rays >= box[:2]) & (rays <= box[2:])).all(-1) & (instance != object_id)
        if not inside.any():
            continue
        hit = cast(object_id, rays[inside])
        closer = hit < depth[inside]
        depth[inside] = np.where(closer, hit, depth[inside])
        instance[inside] = np.where(closer, object_id, instance[inside])
    normal = _normals(layers, xy, depth, instance)
    return {
        "rgb": resample_colour(layers["rgb"], xy),
        "depth": depth.astype(np.float32),
        "instance": instance,
        "normal": normal,
    }


def resample_values(values: NDArray[np.float32], xy: Array) -> NDArray[np.float32]:
    """Interpolate an image (h, w) linearly at positions (H, W, 2), COLMAP pixels."""
    corners, weights = _corners(xy)
    terms = (w * values[c] for c, w in zip(corners, weights, strict=True))
    return np.asarray(sum(terms), np.float32)


def resample_colour(rgb: NDArray[np.uint8], xy: Array) -> NDArray[np.uint8]:
    """Interpolate the colours of an image (h, w, 3) at positions (H, W, 2) by Catmull-Rom cubics.

    Where neighbouring positions are more than a pixel apart, as at the edge of a wide lens, several
    samples are averaged against aliasing. Positions are not rounded, in contrast to OpenCV's
    ``remap``, which rounds them to 1/32 pixel.
    """
    across, down = np.gradient(xy, axis=1), np.gradient(xy, axis=0)
    colours = np.zeros((*xy.shape[:2], 3), np.float32)
    offsets = [(a, b) for b in _list_offsets(down) for a in _list_offsets(across)]
    limit = np.array(rgb.shape[1::-1]) - 1.5
    for a, b in offsets:
        colours += _interpolate(rgb, np.clip(xy + a + b, 1.5, limit - 1e-6))
    return np.rint(np.clip(colours / len(offsets), 0, 255)).astype(np.uint8)


def _list_offsets(step: Array) -> list[Array]:
    """Return the offsets (H, W, 2) of the samples that are averaged along a pixel's side.

    A pixel of the source already averages over one pixel, by its rendering filter. The samples are
    spread so that they and the filter together cover the whole side.
    """
    length = np.linalg.norm(step, axis=-1, keepdims=True)
    count = math.ceil(length.max() - _SINGLE_SAMPLE_GROWTH)
    if count < 2:
        return [np.zeros_like(step)]
    missing = step * np.sqrt(np.maximum(1 - 1 / np.maximum(length, 1) ** 2, 0))
    return [missing * ((k + 0.5) / count - 0.5) for k in range(count)]


def _interpolate(rgb: NDArray[np.uint8], xy: Array) -> NDArray[np.float32]:
    """Interpolate colours (H, W, 3) at positions; at edges they overshoot 0..255."""
    x, y = np.moveaxis(xy - 0.5, -1, 0)
    column, row = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
    across, down = _cubic(x - column), _cubic(y - row)
    source = rgb.astype(np.float32)
    out = np.zeros((*xy.shape[:2], 3), np.float32)
    for j in range(4):
        line = np.zeros_like(out)
        for i in range(4):
            line += across[i][..., None] * source[row + j - 1, column + i - 1]
        out += down[j][..., None] * line
    return out


def _cubic(t: Array) -> NDArray[np.float32]:
    """Return weights (4, ...) of the neighbours at -1, 0, 1, 2 for positions ``t`` in [0, 1)."""
    weights = (
        ((-t + 2) * t - 1) * t,
        (3 * t - 5) * t * t + 2,
        ((-3 * t + 4) * t + 1) * t,
        (t - 1) * t * t,
    )
    return np.asarray(0.5 * np.stack(weights), np.float32)


def _corners(xy: Array) -> tuple[list[tuple[NDArray[Any], NDArray[Any]]], list[Array]]:
    """Return the indices of the four pixels around every position, and their bilinear weights."""
    x, y = np.moveaxis(xy - 0.5, -1, 0)
    left, top = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
    fx, fy = x - left, y - top
    corners = [(top + j, left + i) for j in (0, 1) for i in (0, 1)]
    return corners, [(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy]


def _surface(
    depth: NDArray[np.float32], instance: NDArray[np.uint16], xy: Array, rays: Array, cast: Cast
) -> tuple[Array, NDArray[np.uint16]]:
    """Return the planar depth and the object at every position, both (H, W)."""
    corners, weights = _corners(xy)
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape), where=depth > 0)
    flat = _find_flat(depth, inverse, instance)
    z = sum(w * inverse[c] for c, w in zip(corners, weights, strict=True))
    z = np.divide(1.0, z, out=np.zeros(z.shape), where=z > 0)
    plane = np.logical_and.reduce([flat[c] for c in corners])
    shown = instance[corners[0]]

    rough = np.nonzero(~plane)
    row, column = (index[rough] for index in corners[0])
    last = np.array(depth.shape) - 1
    # Leaves and wires are often visible only in pixels next to the four around the ray.
    neighbours = [
        (np.clip(row + j, 0, last[0]), np.clip(column + i, 0, last[1]))
        for j in (0, 1, -1, 2)
        for i in (0, 1, -1, 2)
    ]
    # The ground can occlude objects also where no neighbouring pixel shows it.
    cast_rays = rays[rough]
    best = cast(0, cast_rays)
    best_id = np.zeros(len(best), np.uint16)
    for k, corner in enumerate(neighbours):
        candidate = instance[corner]
        new = candidate > 0
        for earlier in neighbours[:k]:
            new &= instance[earlier] != candidate
        at = np.nonzero(new)[0]
        at = at[np.argsort(candidate[at], kind="stable")]
        ids, starts = np.unique(candidate[at], return_index=True)
        for object_id, rows in zip(ids.tolist(), np.split(at, starts[1:]), strict=False):
            hit = cast(object_id, cast_rays[rows])
            closer = hit < best[rows]
            best[rows[closer]] = hit[closer]
            best_id[rows[closer]] = object_id
    # A ray between leaves may miss all candidates. Its depth and id are those of the nearest pixel.
    nearest = tuple(np.floor(xy[rough]).astype(np.intp).T[::-1])
    missed = ~np.isfinite(best)
    z[rough] = np.where(missed, depth[nearest], best)
    shown[rough] = np.where(missed, instance[nearest], best_id)
    return z, shown


def _find_flat(
    depth: NDArray[np.float32], inverse: Array, instance: NDArray[np.uint16]
) -> NDArray[np.bool_]:
    """Return which pixels lie on one plane of one object with their four neighbours."""
    flat = depth > 0
    for axis in (0, 1):
        ahead, behind = np.roll(inverse, -1, axis), np.roll(inverse, 1, axis)
        flat &= np.abs(ahead - 2 * inverse + behind) * np.square(depth) < _FLAT_M
        for step in (-1, 1):
            flat &= np.roll(instance, step, axis) == instance
    return flat


def _normals(
    layers: dict[str, NDArray[Any]], xy: Array, depth: Array, instance: NDArray[np.uint16]
) -> NDArray[np.int8]:
    """Return the normal of the neighbouring pixel on the same object that is closest in depth.

    Without such a pixel, as on a post thinner than a pixel, the normal is that of another object.
    """
    corners, _ = _corners(xy)
    far = np.inf
    gaps = np.stack(
        [
            np.where(layers["instance"][c] == instance, np.abs(layers["depth"][c] - depth), far)
            for c in corners
        ]
    )
    choice = gaps.argmin(0)
    rows = np.choose(choice, [row for row, _ in corners])
    columns = np.choose(choice, [column for _, column in corners])
    return np.asarray(layers["normal"][rows, columns])
