"""Meshes of single objects: buildings, and objects that follow the ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simulate.look.buildings import building_mesh
from simulate.look.mesh import Mesh
from simulate.look.plants import fence_mesh, hedge_mesh
from simulate.look.props import shape_mesh
from simulate.look.wires import wire_mesh
from simulate.place.world import World, WorldObject


def individual_mesh(item: WorldObject, world: World) -> Mesh | None:
    """Return the mesh of an object in metres; None if it shares the mesh of its shape."""
    if item.class_name == "building":
        return building_mesh(item)
    if item.class_name == "hedge":
        return hedge_mesh(item, world.terrain)
    if item.class_name == "fence":
        return fence_mesh(item, world.terrain)
    if item.class_name == "wire":
        return wire_mesh(item, world.terrain)
    return None if item.slope is None else _leaning_mesh(item)


def _leaning_mesh(item: WorldObject) -> Mesh:
    """Return the mesh of an object on a slope: vertices are raised by the slope of the ground."""
    mesh = shape_mesh(item.shape).scale_by((*item.size[:2], item.height_m))
    vertices = mesh.vertices.copy()
    vertices[:, 2] += vertices[:, :2] @ np.asarray(item.slope, np.float32)
    return replace(mesh, vertices=vertices)
