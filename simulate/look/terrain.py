"""Build meshes of the ground: the place, its raised pavements, and the land around it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simulate.look.conditions import Condition
from simulate.look.mesh import Mesh, grid_mesh, merge
from simulate.place.world import MIRRORED_M, Kerb, World

Array = NDArray[np.float64]

_STEP_M = 8.0  # distance between the nodes of the mirrored ground
# Extent and number of nodes of the countryside around the mirrored ground.
_FAR_M, _FAR_NODES = 2400.0, 26
_HILLS_M, _HILLS_START_M = 150.0, 150.0  # height of the hills, and distance at which they begin
_AIR_RGB = np.array([0.22, 0.26, 0.31])  # linear colour of haze
_FOOT_M = 0.05  # kerbs reach this far into the ground
_STONE_M, _STONE_RGB = 0.22, (0.30, 0.29, 0.275)  # width and linear albedo of kerb stones


def ground_mesh(world: World, condition: Condition) -> Mesh:
    """Return the ground of the area on its nodes, its mirror image around it, and distant hills."""
    half, count = world.terrain.half_side_m, len(world.terrain.nodes)
    near = half + np.arange(_STEP_M, MIRRORED_M + 1, _STEP_M)
    far = half + np.geomspace(MIRRORED_M, _FAR_M, _FAR_NODES)[1:]
    outer = np.concatenate([near, far])
    axis = np.concatenate([-outer[::-1], np.linspace(-half, half, count), outer])
    x, y = np.meshgrid(axis, axis)
    outside_m = np.maximum(np.maximum(np.abs(x), np.abs(y)) - half, 0.0)
    surface = world.terrain.height(x, y)
    if world.bare_ground is not None:  # objects of a site are not mirrored around it
        surface = np.where(outside_m > 0, world.bare_ground.height(x, y), surface)
    fade = np.exp(-((outside_m / 150.0) ** 2))
    z = world.level_m + (surface - world.level_m) * fade + _hills(x, y, outside_m)
    mesh = grid_mesh(axis, axis, z, "ground")
    textured_m = world.side_m + 2 * world.margin_m
    mesh.uv[:] = mesh.uv / textured_m + 0.5  # the image covers the area once

    middle = mesh.vertices[mesh.corners.reshape(-1, 4)].mean(1)
    is_countryside = np.abs(middle[:, :2]).max(1) > half + MIRRORED_M
    tint = mesh.tint.copy()
    away = np.abs(middle[is_countryside, :2]).max(1) - half
    tint[is_countryside] = _countryside_tints(
        middle[is_countryside].astype(float), away.astype(float), condition
    )
    mesh = replace(
        mesh, tint=tint, material=is_countryside.astype(np.int32), materials=("ground", "plain")
    )
    # Quads at walls of a surface model are not planar.
    return mesh if world.imagery is None else mesh.triangulate()


def kerbs_mesh(world: World) -> Mesh | None:
    """Return the raised pavements (kerb, top and far edge); None for a place without them."""
    if not world.kerbs:
        return None
    mesh = merge([_kerb_mesh(kerb, world) for kerb in world.kerbs])
    mesh.uv[:] = mesh.uv / world.side_m + 0.5
    return mesh


def _kerb_mesh(kerb: Kerb, world: World) -> Mesh:
    """Return one pavement as a strip between five edges along it.

    The edges are the foot and the top of the kerb, the back of the kerb stones, and the top and the
    foot of the far edge.
    """
    outwards = kerb.back - kerb.front
    behind = kerb.front + _STONE_M * outwards / np.linalg.norm(outwards, axis=1, keepdims=True)
    edges = np.stack([kerb.front, kerb.front, behind, kerb.back, kerb.back])
    above = [np.full_like(kerb.rise, -_FOOT_M), *[kerb.rise] * 3, np.full_like(kerb.rise, -_FOOT_M)]
    height = world.terrain.height(edges[..., 0], edges[..., 1]) + np.stack(above)
    k, i = (a.ravel() for a in np.mgrid[:4, : len(kerb.rise) - 1])
    corners = np.stack([(k, i), (k, i + 1), (k + 1, i + 1), (k + 1, i)], axis=1)  # (2, 4, P)
    flat = (corners[0] * len(kerb.rise) + corners[1]).T
    stone = k < 2
    points = np.concatenate([edges, height[..., None]], -1).reshape(-1, 3)
    return Mesh(
        # Faces share no vertices, because shared ones would be shaded smoothly.
        vertices=points[flat.ravel()].astype(np.float32),
        corners=np.arange(flat.size, dtype=np.int32),
        sizes=np.full(len(k), 4, np.int32),
        uv=edges.reshape(-1, 2)[flat].reshape(-1, 2).astype(np.float32),
        tint=np.where(stone[:, None], _STONE_RGB, 1.0).astype(np.float32),
        material=stone.astype(np.int32),
        materials=("ground", "plain"),
    )


def _hills(x: Array, y: Array, outside_m: Array) -> Array:
    """Return the heights (R, C) of hills at points ``outside_m`` (R, C) metres outside the place.

    The hills vary with the direction from the origin and rise with the distance.
    """
    turn = np.arctan2(y, x)
    waves = ((0.22, 3, 1.0), (0.12, 7, 2.0), (0.06, 17, 0.0))
    ridge = 0.60 + sum(size * np.sin(count * turn + phase) for size, count, phase in waves)
    share = np.clip((outside_m - _HILLS_START_M) / (0.6 * _FAR_M), 0.0, 1.0)
    return np.asarray(_HILLS_M * ridge * share * share * (3 - 2 * share))


def _countryside_tints(
    points: Array, outside_m: Array, condition: Condition
) -> NDArray[np.float32]:
    """Return the tints (N, 3) of woods, fields and meadows at points (N, 3).

    The points lie ``outside_m`` (N,) metres outside the place. Distant points are tinted by haze.
    """
    x, y, _ = points.T
    patch = np.sin(x / 61.0 + 1.3 * np.sin(y / 83.0)) + np.sin(y / 47.0 + 1.7 * np.sin(x / 97.0))
    woods = (patch + outside_m / 500.0 > 1.2)[:, None]
    fields = (patch < -0.5)[:, None]
    season = condition.season
    open_land = np.where(fields, season.ground["field"][1], season.ground["grass"][0])
    foliage = 0.6 * np.array(season.leaf) + 0.4 * np.array(season.leaf_tip)
    tint = np.where(woods, foliage, open_land)
    air = 0.45 * (1 - np.exp(-outside_m / 1500.0))[:, None]
    return np.asarray(tint + air * (_AIR_RGB - tint), np.float32)
