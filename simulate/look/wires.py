"""Build meshes of the wires of power lines."""

from __future__ import annotations

import numpy as np

from simulate.look.mesh import Mesh, MeshBuilder
from simulate.place.power import WIRE_RADIUS_M, WIRE_SPACING_M, wire_heights
from simulate.place.world import Heightfield, WorldObject


def wire_mesh(wire: WorldObject, terrain: Heightfield) -> Mesh:
    """Build the wires of one span, in the frame of its box (origin at the box's centre)."""
    half = 0.5 * wire.size[0]
    direction = np.array([np.cos(wire.yaw), np.sin(wire.yaw)])
    ends = wire.centre[:2] + np.array([[-half], [half]]) * direction
    z = wire_heights(terrain, ends) - wire.centre[2]
    x = np.linspace(-half, half, len(z))
    out = MeshBuilder()
    for y in (-0.5 * WIRE_SPACING_M, 0.5 * WIRE_SPACING_M):
        for k in range(len(z) - 1):
            top = [(x[k], z[k]), (x[k + 1], z[k + 1])]
            profile = [(a, b - 2 * WIRE_RADIUS_M) for a, b in top] + top[::-1]
            out.prism(profile, (y - WIRE_RADIUS_M, y + WIRE_RADIUS_M), "paint")
    return out.build()
