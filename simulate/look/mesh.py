"""Polygon meshes as arrays, and a builder that assembles them from polygons, prisms and boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulate.place.world import Rgb

WHITE: Rgb = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Mesh:
    """P polygons, each with a material, a tint and texture coordinates.

    Attributes:
        vertices: Vertices (V, 3), metres.
        corners: Index (L,) of the vertex at every corner, polygon after polygon.
        sizes: Number (P,) of corners of each polygon.
        uv: Texture coordinates (L, 2) of the corners.
        tint: Tint (P, 3) of each polygon, linear RGB.
        material: Index (P,) into ``materials``.
        materials: Names of the materials.
    """

    vertices: NDArray[np.float32]
    corners: NDArray[np.int32]
    sizes: NDArray[np.int32]
    uv: NDArray[np.float32]
    tint: NDArray[np.float32]
    material: NDArray[np.int32]
    materials: tuple[str, ...]

    def scale_by(self, scale: ArrayLike, offset: ArrayLike = (0.0, 0.0, 0.0)) -> Mesh:
        """Return the mesh with its vertices times ``scale`` (3,) plus ``offset`` (3,)."""
        vertices = (self.vertices * np.asarray(scale) + np.asarray(offset)).astype(np.float32)
        return Mesh(
            vertices, self.corners, self.sizes, self.uv, self.tint, self.material, self.materials
        )

    def fit_to_cube(self) -> Mesh:
        """Return the mesh scaled and moved into the unit cube [-0.5, 0.5]^3."""
        low, high = self.vertices.min(0), self.vertices.max(0)
        scale = 1.0 / np.maximum(high - low, 1e-6)
        return self.scale_by(scale, -0.5 * (low + high) * scale)

    def triangulate(self) -> Mesh:
        """Return the mesh with each quad cut into two triangles, from its first to its third
        corner.

        Raises:
            ValueError: a polygon does not have four corners.
        """
        if (self.sizes != 4).any():
            raise ValueError("only quads can be cut into two triangles")
        order = np.array([0, 1, 2, 0, 2, 3])
        return Mesh(
            vertices=self.vertices,
            corners=self.corners.reshape(-1, 4)[:, order].ravel(),
            sizes=np.full(2 * len(self.sizes), 3, np.int32),
            uv=self.uv.reshape(-1, 4, 2)[:, order].reshape(-1, 2),
            tint=np.repeat(self.tint, 2, axis=0),
            material=np.repeat(self.material, 2),
            materials=self.materials,
        )


class MeshBuilder:
    """Collects polygons and makes a ``Mesh`` of them."""

    def __init__(self) -> None:
        self._vertices: list[NDArray[np.float64]] = []
        self._sizes: list[int] = []
        self._uv: list[NDArray[np.float64]] = []
        self._tint: list[Rgb] = []
        self._material: list[str] = []

    def polygon(
        self,
        points: ArrayLike,
        material: str = "plain",
        tint: Rgb = WHITE,
        uv: ArrayLike | None = None,
    ) -> None:
        """Add a flat polygon (K, 3), anticlockwise seen from outside.

        ``uv`` (K, 2) is 0 by default.
        """
        points = np.asarray(points, float)
        self._vertices.append(points)
        self._sizes.append(len(points))
        self._uv.append(np.zeros((len(points), 2)) if uv is None else np.asarray(uv, float))
        self._tint.append(tint)
        self._material.append(material)

    def prism(
        self,
        profile: ArrayLike,
        y: tuple[float, float],
        material: str = "plain",
        tint: Rgb = WHITE,
    ) -> None:
        """Add the solid between two values of y with the profile (K, 2) in x and z.

        The profile is anticlockwise seen from -y.
        """
        profile = np.asarray(profile, float)
        front, back = (np.insert(profile, 1, v, axis=1) for v in y)
        self.polygon(front, material, tint)
        self.polygon(back[::-1], material, tint)
        for i in range(len(profile)):
            j = (i + 1) % len(profile)
            self.polygon([front[j], front[i], back[i], back[j]], material, tint)

    def box(
        self, low: ArrayLike, high: ArrayLike, material: str = "plain", tint: Rgb = WHITE
    ) -> None:
        """Add the axis-aligned box between two corners (3,)."""
        (x0, y0, z0), (x1, y1, z1) = np.asarray(low, float), np.asarray(high, float)
        self.prism([(x0, z0), (x1, z0), (x1, z1), (x0, z1)], (y0, y1), material, tint)

    def build(self) -> Mesh:
        """Return the mesh of all polygons added so far."""
        names = tuple(dict.fromkeys(self._material))
        vertices = np.concatenate(self._vertices)
        return Mesh(
            vertices=vertices.astype(np.float32),
            corners=np.arange(len(vertices), dtype=np.int32),
            sizes=np.array(self._sizes, np.int32),
            uv=np.concatenate(self._uv).astype(np.float32),
            tint=np.array(self._tint, np.float32),
            material=np.array([names.index(m) for m in self._material], np.int32),
            materials=names,
        )


def grid_mesh(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], material: str
) -> Mesh:
    """Return a surface over x (C,) and y (R,) with heights z (R, C).

    Texture coordinates are x, y.
    """
    rows, columns = z.shape
    xx, yy = np.meshgrid(x, y)
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    corners = np.stack([first, first + 1, first + columns + 1, first + columns], -1).ravel()
    count = len(first)
    uv = np.stack([xx.ravel(), yy.ravel()], -1)[corners]
    return Mesh(
        vertices=np.stack([xx, yy, z], -1).reshape(-1, 3).astype(np.float32),
        corners=corners.astype(np.int32),
        sizes=np.full(count, 4, np.int32),
        uv=uv.astype(np.float32),
        tint=np.ones((count, 3), np.float32),
        material=np.zeros(count, np.int32),
        materials=(material,),
    )


def triangle_mesh(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int64],
    material: str,
    tint: NDArray[np.float64],
) -> Mesh:
    """Return a mesh of triangles (T, 3) over vertices (V, 3) with tints (T, 3) and one material."""
    return Mesh(
        vertices=vertices.astype(np.float32),
        corners=triangles.ravel().astype(np.int32),
        sizes=np.full(len(triangles), 3, np.int32),
        uv=np.zeros((triangles.size, 2), np.float32),
        tint=tint.astype(np.float32),
        material=np.zeros(len(triangles), np.int32),
        materials=(material,),
    )


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """Join several meshes into one."""
    names = tuple(dict.fromkeys(name for m in meshes for name in m.materials))
    base = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    return Mesh(
        vertices=np.concatenate([m.vertices for m in meshes]),
        corners=np.concatenate(
            [m.corners + np.int32(b) for m, b in zip(meshes, base[:-1], strict=True)]
        ),
        sizes=np.concatenate([m.sizes for m in meshes]),
        uv=np.concatenate([m.uv for m in meshes]),
        tint=np.concatenate([m.tint for m in meshes]),
        material=np.concatenate(
            [np.array([names.index(n) for n in m.materials], np.int32)[m.material] for m in meshes]
        ),
        materials=names,
    )
