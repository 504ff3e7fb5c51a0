"""Render views of an orthophoto on its surface model by ray marching.

The world is east-north-up; the rasters have coordinate systems of their own, in which a ray is a
parabola (``geo.local_coordinates``). Rays are followed in the rasters' pixels, so no raster is
resampled before rendering.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.scene.geo.local_coordinates import LocalProjection
from objconnect.scene.geo.rasters import Box, Patch, Raster
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic, geodetic_from_enu

Array = NDArray[np.float64]

# Bisections of the step in which a ray enters the surface.
_BISECTIONS = 6
# Side (px) of square cells of the surface model. The highest point of each cell is stored: a ray
# that stays above it skips the cell.
_CELL = 8
# Rays are followed beyond the lowest and highest surface by this margin, metres, and by this share
# of the height of the camera above it.
_MARGIN_M, _MARGIN_SHARE = 1.0, 0.01
# Rays that fall less than this per metre of depth are treated as missing the ground.
_MIN_FALL = 0.05


class View(NamedTuple):
    """A rendered view.

    Attributes:
        rgb: (H, W, 3) uint8; the mean colour where there is no surface.
        depth: (H, W) float32 planar depth, metres, 0 where there is no surface.
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]

    @property
    def coverage(self) -> float:
        """Return the share of pixels that show the surface."""
        return float((self.depth > 0).mean())


class _Rays(NamedTuple):
    """Rays of pixels, and the interval of depth in which each may meet the surface.

    Attributes:
        start: (3,) centre of the camera, world metres.
        directions: (N, 3) for a planar depth of 1.
        first: (N,) start of the interval, metres of depth.
        last: (N,) end of the interval; not above ``first`` where a ray misses the ground.
    """

    start: Array
    directions: Array
    first: Array
    last: Array

    def limit_heights(
        self, camera_height: float, lowest: float, highest: float, farthest: float
    ) -> _Rays:
        """Return the same rays between two heights; the camera is at ``camera_height``."""
        fall = -self.directions[:, 2]
        down = np.maximum(fall, _MIN_FALL)
        begins = (camera_height - highest) * (1 - _MARGIN_SHARE) - _MARGIN_M
        ends = (camera_height - lowest) * (1 + _MARGIN_SHARE) + _MARGIN_M
        last = np.where(fall > _MIN_FALL, np.minimum(ends / down, farthest), 0.0)
        return self._replace(first=np.maximum(begins / down, 0.0), last=last)

    @property
    def may_hit(self) -> NDArray[np.bool_]:
        """Return which rays may meet the surface, (N,)."""
        return self.last > self.first

    def ends(self) -> Array:
        """Return both ends of the intervals that may meet the surface, (M, 3) world metres."""
        rays = self.directions[self.may_hit]
        depths = (self.first[self.may_hit], self.last[self.may_hit])
        return np.concatenate([self.start + depth[:, None] * rays for depth in depths])


@dataclass(frozen=True)
class Surface:
    """An orthophoto on a surface model.

    Attributes:
        colours: orthophoto.
        heights: surface model.
        undulation: height of the geoid above the ellipsoid, metres, which is added to the heights.
        origin: origin of the world.
        low: lowest height of the surface model including the undulation, metres.
        high: highest height, also including the undulation, metres.
    """

    colours: Raster
    heights: Raster
    undulation: float
    origin: Geodetic
    low: float
    high: float

    def render(self, camera: Camera, cam_from_world: Array, farthest: float) -> View:
        """Render a view.

        Args:
            camera: camera of the view.
            cam_from_world: (4, 4).
            farthest: maximum depth, metres; farther surfaces are not rendered.

        Raises:
            InputError: a raster is damaged.
        """
        start = -cam_from_world[:3, :3].T @ cam_from_world[:3, 3]
        local, _ = camera.unproject(camera.pixel_grid().reshape(-1, 2))
        nothing = np.zeros(len(local))
        rays = _Rays(start, local.numpy() @ cam_from_world[:3, :3], nothing, nothing)
        geodetic = geodetic_from_enu(start, self.origin)
        camera_height = float(self.heights.grid.projection.from_geodetic(geodetic)[2])
        rays = rays.limit_heights(camera_height, self.low, self.high, farthest)
        depth = (
            self._depth(camera, rays, camera_height, farthest) if rays.may_hit.any() else nothing
        )
        rgb = self._paint(camera, rays, depth)
        shape = (camera.height, camera.width)
        return View(rgb.reshape(*shape, 3), depth.reshape(shape).astype(np.float32))

    def _depth(self, camera: Camera, rays: _Rays, camera_height: float, farthest: float) -> Array:
        """Return the depth at which rays meet the surface, (N,), 0 where they do not."""
        local, box = _fit_projection(self.heights, self.origin, rays.ends())
        pixel = float(np.median(rays.last[rays.may_hit])) / camera.focal[0]
        patch = self.heights.patch(box, pixel)
        heights = patch.values[np.isfinite(patch.values)] + self.undulation
        if not heights.size:
            return np.zeros(len(rays.first))
        rays = rays.limit_heights(
            camera_height, float(heights.min()), float(heights.max()), farthest
        )
        return _march(rays, local, patch, self.undulation)

    def _paint(self, camera: Camera, rays: _Rays, depth: Array) -> NDArray[np.uint8]:
        """Return colours (N, 3) where rays meet the surface; set depths without a colour to 0."""
        colours = np.full((len(depth), 3), np.nan)
        is_hit = depth > 0
        if is_hit.any():
            points = rays.start + depth[is_hit, None] * rays.directions[is_hit]
            pixel = float(np.median(depth[is_hit])) / camera.focal[0]
            colours[is_hit] = sample_colours(self.colours, self.origin, points, pixel)
        known = np.isfinite(colours).all(1)
        depth[~known] = 0
        colours[~known] = colours[known].mean(0) if known.any() else 0
        return np.asarray(np.rint(np.clip(colours, 0, 255)), np.uint8)


def sample_colours(orthophoto: Raster, origin: Geodetic, points: Array, pixel: float) -> Array:
    """Return the colours of an orthophoto at points of the world.

    Args:
        orthophoto: orthophoto in any reference system.
        origin: origin of the world.
        points: (N, 3) world metres; at least one.
        pixel: distance of neighbouring points on the ground, metres.

    Returns:
        (N, 3) colours in 0..255; NaN where there is no data.

    Raises:
        InputError: the orthophoto is damaged.
    """
    local, box = _fit_projection(orthophoto, origin, points)
    image = _Image(orthophoto.patch(box, pixel))
    coordinates = local.coordinates(points)
    x, y = (
        torch.from_numpy(z).float() for z in image.normalise(coordinates[:, 0], coordinates[:, 1])
    )
    sampled = image.sample(x, y, "bicubic").numpy().T
    return np.array(np.broadcast_to(sampled, (len(points), 3)), np.float64)


def _fit_projection(raster: Raster, origin: Geodetic, points: Array) -> tuple[LocalProjection, Box]:
    """Return the projection to a raster around points (N, 3), and their bounding box there."""
    low, high = points.min(0) - _MARGIN_M, points.max(0) + _MARGIN_M
    local = LocalProjection.fit(raster.grid.projection, origin, low, high)
    coordinates = local.coordinates(points)
    (left, bottom, _), (right, top, _) = coordinates.min(0).tolist(), coordinates.max(0).tolist()
    return local, Box(left, bottom, right, top)


class _Image:
    """A patch interpolated between its pixel centres; NaN beyond its edges.

    Attributes:
        values: (1, bands, H, W) float32, padded with NaN to sides that are multiples of ``_CELL``.
    """

    def __init__(self, patch: Patch) -> None:
        self._grid = patch.grid
        padding = [(1, _CELL - (side + 1) % _CELL) for side in patch.values.shape[1:]]
        padded = np.pad(patch.values, ((0, 0), *padding), constant_values=np.nan)
        self.values = torch.from_numpy(padded)[None]

    def normalise(self, east: Array, north: Array) -> tuple[Array, Array]:
        """Return normalised coordinates as ``grid_sample`` takes them, -1 to 1 between edges."""
        columns, rows = self._grid.columns_rows(east, north)
        height, width = self.values.shape[2:]
        return (columns + 1) * (2 / width) - 1, (rows + 1) * (2 / height) - 1

    def sample(self, x: Tensor, y: Tensor, mode: str = "bilinear") -> Tensor:
        """Return values (bands, N) at normalised coordinates (N,)."""
        return _sample(self.values, x, y, mode)

    def ceiling(self) -> Tensor:
        """Return the highest value of each cell and its eight neighbours, (1, bands, h, w)."""
        high = torch.nan_to_num(self.values, nan=-math.inf)
        cells = torch.nn.functional.max_pool2d(high, _CELL)
        return torch.nn.functional.max_pool2d(cells, 3, stride=1, padding=1)


def _sample(values: Tensor, x: Tensor, y: Tensor, mode: str) -> Tensor:
    grid = torch.stack([x, y], -1)[None, None]
    sampled: Tensor = torch.nn.functional.grid_sample(
        values, grid, mode=mode, padding_mode="border", align_corners=False
    )
    return sampled[0, :, 0]


class _Parabolas(NamedTuple):
    """Rays in a surface model as quadratic functions of depth, coefficients (3, N) float32 each.

    The rows are normalised coordinates x and y, and height in metres above ``zero``, the lowest
    point of the patch.
    """

    constant: Tensor
    linear: Tensor
    quadratic: Tensor

    @staticmethod
    def of(rays: _Rays, local: LocalProjection, image: _Image, zero: float) -> _Parabolas:
        """Convert rays to parabolas."""
        a, b, c = local.expand_rays(rays.start, rays.directions)
        # Normalised coordinates are linear in east and north.
        x, y = image.normalise(np.array([0.0, 1.0]), np.array([0.0, 1.0]))
        scale = np.array([x[1] - x[0], y[1] - y[0], 1.0])
        first = np.array([*(z.item() for z in image.normalise(a[0], a[1])), a[2] - zero])
        constant = np.repeat(first[:, None], len(b), 1)
        parts = (constant, (b * scale).T, (c * scale).T)
        return _Parabolas(*(torch.from_numpy(part.astype(np.float32)) for part in parts))

    def select(self, which: Tensor) -> _Parabolas:
        """Return the selected parabolas."""
        return _Parabolas(*(part[:, which] for part in self))

    def evaluate(self, depth: Tensor) -> Tensor:
        """Return x, y and height at depths (N,), (3, N)."""
        return self.constant + depth * (self.linear + depth * self.quadratic)


def _march(rays: _Rays, local: LocalProjection, patch: Patch, undulation: float) -> Array:
    """Return the depth (N,) where rays first pass below the surface, 0 where they do not.

    A ray that passes through a hole of the surface model, and is below the surface after the hole,
    has no intersection.
    """
    image = _Image(patch)
    which = np.flatnonzero(rays.may_hit)
    zero = undulation + float(np.nanmin(patch.values))
    image.values -= zero - undulation
    parabolas = _Parabolas.of(rays, local, image, zero).select(torch.from_numpy(which))
    first, last = (torch.from_numpy(d[which].astype(np.float32)) for d in (rays.first, rays.last))
    horizontal = torch.from_numpy(np.linalg.norm(rays.directions[which, :2], axis=1)).float()
    # Depth (m) over which a ray crosses a pixel, bounded for steep rays.
    step = min(patch.grid.ground_pixel) / horizontal.clamp_min(0.2)
    first = _skip_free_space(parabolas, image.ceiling(), first, last, step)
    shallow, deep = _bracket_entry(parabolas, image, first, last, step)
    hit = torch.nonzero(deep > 0)[:, 0]
    depth = np.zeros(len(rays.first))
    if len(hit):
        entry = _refine_entry(parabolas.select(hit), image, shallow[hit], deep[hit])
        depth[which[hit.numpy()]] = entry.double().numpy()
    return depth


def _clearance(parabolas: _Parabolas, image: _Image, depth: Tensor) -> Tensor:
    """Return the height of rays above the surface at a depth, (N,) metres."""
    x, y, height = parabolas.evaluate(depth)
    clearance: Tensor = height - image.sample(x, y)[0]
    return clearance


def _skip_free_space(
    parabolas: _Parabolas, ceiling: Tensor, first: Tensor, last: Tensor, step: Tensor
) -> Tensor:
    """Return depths (N,) up to which rays are certainly above the surface.

    A ray advances from cell to cell while it stays above the highest point around each.
    """
    depth = first.clone()
    stride = (_CELL - 1) * step
    active = torch.nonzero(depth < last)[:, 0]
    while len(active):
        active_parabolas = parabolas.select(active)
        x, y, _ = active_parabolas.evaluate(depth[active])
        below = active_parabolas.evaluate(depth[active] + stride[active])[2]
        free = below > _sample(ceiling, x, y, "nearest")[0]
        active = active[free]
        depth[active] += stride[active]
        active = active[depth[active] < last[active]]
    return depth


def _bracket_entry(
    parabolas: _Parabolas, image: _Image, first: Tensor, last: Tensor, step: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the depths (N,) before and after the step in which a ray enters the surface, or 0."""
    shallow, deep = torch.zeros_like(first), torch.zeros_like(first)
    active = torch.nonzero(first < last)[:, 0]
    active_parabolas, depth = parabolas.select(active), first[active]
    last_clear = torch.full_like(depth, math.nan)
    while len(active):
        clear = _clearance(active_parabolas, image, depth)
        entered = (clear <= 0) & (last_clear > 0)
        entering = active[entered]
        deep[entering], shallow[entering] = depth[entered], (depth - step[active])[entered]
        stays = ~(clear <= 0) & (depth < last[active])
        active, last_clear = active[stays], clear[stays]
        active_parabolas = active_parabolas.select(stays)
        depth = depth[stays] + step[active]
    return shallow, deep


def _refine_entry(parabolas: _Parabolas, image: _Image, shallow: Tensor, deep: Tensor) -> Tensor:
    """Return the depth (N,) of the surface between two depths, by bisection and one secant step."""
    for _ in range(_BISECTIONS):
        middle = (shallow + deep) / 2
        below = _clearance(parabolas, image, middle) <= 0
        deep, shallow = torch.where(below, middle, deep), torch.where(below, shallow, middle)
    above, beneath = (_clearance(parabolas, image, depth) for depth in (shallow, deep))
    share = (above / (above - beneath).clamp_min(1e-9)).clamp(0, 1)
    return shallow + torch.nan_to_num(share, nan=1.0) * (deep - shallow)
