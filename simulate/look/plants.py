"""Build meshes of trees, hedges and fences. Crowns consist of opaque triangles, one per leaf.

The red channel of a leaf's tint is a shade value: 0 for dark inner leaves, 1 for light outer ones.
The material uses it to blend two leaf (or needle) colours of the season.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simulate.look.mesh import Mesh, MeshBuilder, merge, triangle_mesh
from simulate.place.world import Heightfield, WorldObject

Array = NDArray[np.float64]

_BARK = (0.09, 0.065, 0.045)
_TWIG = (0.13, 0.10, 0.08)
# Length (m), radius (m) and number of forks of the trunk, limbs, boughs, branches and twigs.
_BRANCHES = ((2.8, 0.26, 7), (2.3, 0.13, 5), (1.5, 0.07, 5), (1.0, 0.04, 6), (0.7, 0.022, 0))


def broadleaf(variant: int) -> Mesh:
    """Build a broadleaved tree, about 8 m high, crown radius about 4 m, base at z = 0."""
    rng = np.random.default_rng([31, variant])
    crown = np.array([*rng.normal(0, 0.35, 2), 5.2])
    radii = np.array([3.2, 3.2, 2.6]) * rng.uniform(0.8, 1.15, 3)
    lumps = []
    for direction in _sphere(rng, 18):
        reach = rng.uniform(0.45, 0.75)
        centre = crown + reach * radii * direction + rng.normal(0, 0.25, 3)
        lumps.append((centre, rng.uniform(0.8, 2.0)))
    lumps.append((crown, 2.0))
    parts = [_foliage(rng, lumps, leaves=4200, leaf_m=0.34)]
    parts += [_lump(centre, 0.86 * radius, rng) for centre, radius in lumps]
    parts.append(_trunk(3.8, 0.24))
    return merge(parts)


def bare_tree(variant: int) -> Mesh:
    """Build a broadleaved tree without leaves, about 8 m high, with branches down to twigs."""
    out = MeshBuilder()
    _branch(out, np.random.default_rng([34, variant]), np.zeros(3), np.array([0.0, 0.0, 1.0]), 0)
    return out.build()


def conifer(variant: int) -> Mesh:
    """Build a conifer, about 9 m high, radius about 2.2 m, base at z = 0."""
    rng = np.random.default_rng([32, variant])
    lumps = []
    for z in np.linspace(1.4, 8.4, 12):
        radius = 2.1 * (1 - z / 9.2) + 0.12
        for turn in rng.uniform(0, 2 * np.pi, max(2, int(5 * radius))):
            reach = 0.6 * radius
            centre = np.array([reach * np.cos(turn), reach * np.sin(turn), z])
            lumps.append((centre, 0.42 * radius + 0.22))
    parts = [_foliage(rng, lumps, leaves=3600, leaf_m=0.26)]
    cone = MeshBuilder()
    ring = np.linspace(0, 2 * np.pi, 10, endpoint=False)
    foot = np.stack([1.3 * np.cos(ring), 1.3 * np.sin(ring), np.full(10, 1.2)], -1)
    for a, b in zip(foot, np.roll(foot, -1, 0), strict=True):
        cone.polygon([a, b, (0, 0, 8.6)], "leaf", (0.05, 0, 0))
    parts += [cone.build(), _trunk(2.0, 0.18)]
    tree = merge(parts)
    evergreen = tuple("needle" if name == "leaf" else name for name in tree.materials)
    return replace(tree, materials=evergreen)


def hedge_mesh(hedge: WorldObject, terrain: Heightfield) -> Mesh:
    """Build a hedge that follows the ground, in its box's frame (origin at the box's centre)."""
    rng = np.random.default_rng([33, hedge.id])
    length, width, _ = hedge.size
    count = max(2, int(length / 0.5) + 1)
    x = np.linspace(-0.5 * length, 0.5 * length, count)
    ground, height = _profile(hedge, terrain, x)
    half = 0.5 * width * 0.8
    section = np.array([(-half, 0.0), (-half, 0.85), (-0.5 * half, 0.94), (0.5 * half, 0.94),
                        (half, 0.85), (half, 0.0)])  # fmt: skip
    points = np.empty((count, len(section), 3))
    points[..., 0] = x[:, None]
    points[..., 1] = section[:, 0] * rng.uniform(0.85, 1.0, (count, 1))
    points[..., 2] = ground[:, None] + section[:, 1] * height
    body = MeshBuilder()
    for k in range(count - 1):
        for i in range(len(section) - 1):
            quad = [points[k, i], points[k, i + 1], points[k + 1, i + 1], points[k + 1, i]]
            body.polygon(quad, "leaf", (0.15, 0, 0))
    body.polygon(points[0], "leaf", (0.15, 0, 0))
    body.polygon(points[-1, ::-1], "leaf", (0.15, 0, 0))

    leaves = int(70 * length)
    along = rng.uniform(-0.5, 0.5, leaves) * (length - 0.2)
    on_top = rng.random(leaves) < 0.4  # else on a side
    y = np.where(on_top, rng.uniform(-1, 1, leaves), np.sign(rng.uniform(-1, 1, leaves)))
    z = np.where(on_top, rng.uniform(0.86, 0.95, leaves), rng.uniform(0.05, 0.9, leaves))
    centres = np.stack([along, y * half, np.interp(along, x, ground) + z * height], -1)
    outward = np.stack([np.zeros(leaves), np.where(on_top, 0, y), np.where(on_top, 1, 0.3)], -1)
    foliage = _leaves(rng, centres, outward, 0.17, rng.uniform(0.35, 1.0, leaves))
    # Leaves outside the box are moved onto its sides.
    limit = 0.5 * hedge.size
    vertices = np.clip(foliage.vertices, [-limit[0], -limit[1], -np.inf], limit)
    return merge([body.build(), replace(foliage, vertices=vertices.astype(np.float32))])


def fence_mesh(fence: WorldObject, terrain: Heightfield) -> Mesh:
    """Build a board fence on the ground, in its box's frame (origin at the box's centre)."""
    length, width, _ = fence.size
    panels = max(1, round(length / 2.0))
    x = np.linspace(-0.5 * length, 0.5 * length, panels + 1)
    ground, height = _profile(fence, terrain, x)
    out = MeshBuilder()
    for i in range(panels):
        base = 0.5 * (ground[i] + ground[i + 1])
        top = base + 0.92 * height
        out.box((x[i], -0.2 * width, base - 0.3), (x[i + 1], 0.2 * width, top), "paint")
    for i in range(panels + 1):
        a = np.clip(x[i] - 0.06, x[0], x[-1] - 0.12)
        out.box(
            (a, -0.5 * width, ground[i] - 0.3), (a + 0.12, 0.5 * width, ground[i] + height), "paint"
        )
    return out.build()


def _profile(item: WorldObject, terrain: Heightfield, x: Array) -> tuple[Array, float]:
    """Return the ground under an object that follows it, and the height of the object above it.

    Ground heights (K,) are at the points ``x`` (K,) along the object, relative to the centre of its
    box. The object's height is measured from the highest of these points to the top of the box.
    """
    direction = np.array([np.cos(item.yaw), np.sin(item.yaw)])
    at = item.centre[:2] + x[:, None] * direction
    ground = terrain.height(at[:, 0], at[:, 1]) - item.centre[2]
    return ground, float(0.5 * item.size[2] - ground.max())


def _sphere(rng: np.random.Generator, count: int) -> Array:
    """Return evenly spread directions (count, 3), turned about z at random."""
    i = np.arange(count) + 0.5
    z = 1 - 2 * i / count
    turn = i * np.pi * (3 - np.sqrt(5)) + rng.uniform(0, 2 * np.pi)
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], -1)


def _foliage(
    rng: np.random.Generator, lumps: list[tuple[Array, float]], leaves: int, leaf_m: float
) -> Mesh:
    """Return leaf triangles on the surfaces of overlapping balls (centre (3,) and radius)."""
    centres = np.array([c for c, _ in lumps])
    radii = np.array([r for _, r in lumps])
    lump = rng.choice(len(lumps), 2 * leaves, p=radii**2 / (radii**2).sum())
    outward = rng.standard_normal((2 * leaves, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    points = centres[lump] + radii[lump, None] * outward * rng.uniform(0.9, 1.06, (2 * leaves, 1))
    # Leaves deep inside another ball are invisible and are left out.
    relative_distance = np.linalg.norm(points[:, None] - centres, axis=-1) / radii
    visible = np.flatnonzero(relative_distance.min(1) > 0.82)[:leaves]
    points, outward = points[visible], outward[visible]
    low, high = points[:, 2].min(), points[:, 2].max()
    lit = 0.25 + 0.5 * (points[:, 2] - low) / (high - low) + 0.25 * outward[:, 2]
    # Clumps differ more than leaves, because aerial photographs resolve clumps and not leaves.
    clump = rng.uniform(-0.3, 0.3, len(lumps))[lump[visible]]
    tone = np.clip(lit + clump + rng.normal(0, 0.08, len(visible)), 0, 1)
    return _leaves(rng, points, outward, leaf_m, tone)


def _leaves(
    rng: np.random.Generator, centres: Array, outward: Array, size_m: float, tone: Array
) -> Mesh:
    """Return a triangle of about ``size_m`` at each centre (N, 3), facing about ``outward``."""
    normal = outward / np.linalg.norm(outward, axis=1, keepdims=True)
    normal = normal + 0.55 * rng.standard_normal(normal.shape)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    a = np.cross(normal, rng.standard_normal(normal.shape))
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b = np.cross(normal, a)
    size = size_m * rng.uniform(0.7, 1.5, (len(centres), 1))
    corners = [centres + size * (c * a + s * b) for c, s in ((1, 0), (-0.5, 0.87), (-0.5, -0.87))]
    vertices = np.stack(corners, 1).reshape(-1, 3)
    triangles = np.arange(len(vertices)).reshape(-1, 3)
    tint = np.stack([tone, 0 * tone, 0 * tone], -1)
    return triangle_mesh(vertices, triangles, "leaf", tint)


def _lump(centre: Array, radius: float, rng: np.random.Generator) -> Mesh:
    """Build a rough dark ball, which closes the gaps between leaves."""
    rings, segments = 6, 9
    phi = np.linspace(0, np.pi, rings)[:, None]
    turn = np.linspace(0, 2 * np.pi, segments, endpoint=False)[None]
    unit = np.stack(
        [np.sin(phi) * np.cos(turn), np.sin(phi) * np.sin(turn), np.cos(phi) + 0 * turn], -1
    )
    unit *= rng.uniform(0.9, 1.05, (rings, segments, 1))
    grid = (centre + radius * unit).reshape(-1, 3)
    k, i = (a.ravel() for a in np.mgrid[: rings - 1, :segments])
    j = (i + 1) % segments
    p, q, r, s = k * segments + i, (k + 1) * segments + i, (k + 1) * segments + j, k * segments + j
    triangles = np.concatenate([np.stack([p, q, r], -1), np.stack([p, r, s], -1)])
    tint = np.zeros((len(triangles), 3))
    tint[:, 0] = 0.12
    return triangle_mesh(grid, triangles, "leaf", tint)


def _branch(
    out: MeshBuilder, rng: np.random.Generator, foot: Array, along: Array, order: int
) -> None:
    """Add a branch from its foot (3,) in a unit direction (3,), and all branches on it."""
    length, radius, forks = _BRANCHES[order]
    length *= rng.uniform(0.8, 1.2)
    across = np.cross(along, rng.standard_normal(3))
    across /= np.linalg.norm(across)
    third = np.cross(along, across)
    tip = foot + length * along
    ring = [np.cos(t) * across + np.sin(t) * third for t in np.arange(3) * 2 * np.pi / 3]
    for p, q in zip(ring, [*ring[1:], ring[0]], strict=True):
        side = [
            foot + radius * p,
            foot + radius * q,
            tip + 0.5 * radius * q,
            tip + 0.5 * radius * p,
        ]
        out.polygon(side, "plain", _BARK if order < 3 else _TWIG)
    turn = rng.uniform(0, 2 * np.pi) + np.arange(forks) * np.pi * (3 - np.sqrt(5))
    for k in range(forks):
        start = foot + (0.45 + 0.55 * (k + 1) / forks) * length * along
        spread = rng.uniform(0.6, 1.1) * (np.cos(turn[k]) * across + np.sin(turn[k]) * third)
        direction = along + spread + [0.0, 0.0, 0.15]
        _branch(out, rng, start, direction / np.linalg.norm(direction), order + 1)


def _trunk(height: float, radius: float) -> Mesh:
    out = MeshBuilder()
    ring = np.linspace(0, 2 * np.pi, 7, endpoint=False)
    foot = np.stack([radius * np.cos(ring), radius * np.sin(ring), np.full(7, 0.0)], -1)
    top = foot * [0.6, 0.6, 0] + [0, 0, height]
    for i in range(7):
        j = (i + 1) % 7
        out.polygon([foot[i], foot[j], top[j], top[i]], "plain", _BARK)
    return out.build()
