"""Photograph luminous discs that face the camera: `python -m tests.simulate.photograph_dots JOB
DOTS OUT`.

DOTS is npz of world points (N, 3) and radii (N,) in metres, OUT the photograph (H, W, 3) as npy,
made as the renderer makes its own: the same camera, and the same map through the lens.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from simulate.camera.resample import resample_colour
from simulate.render.blender import _add, _render, _set_up_render
from simulate.render.job import RenderJob
from simulate.render.pool import _camera_rays


def main(job_path: str, dots_path: str, out: str) -> None:
    job = RenderJob.model_validate_json(Path(job_path).read_text())
    dots = np.load(dots_path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_circle_add(vertices=64, fill_type="NGON")
    disc = bpy.context.object.data
    bpy.data.objects.remove(bpy.context.object)
    disc.materials.append(
        make_luminous(bpy.data.materials.new("dot"), "ShaderNodeOutputMaterial", 0.8)
    )
    pose = np.array(job.poses[0])
    for point, radius in zip(dots["points"], dots["radii"], strict=True):
        placed = _add("dot", disc)
        placed.rotation_euler = Matrix(pose[:3, :3].T.tolist()).to_euler()
        placed.location, placed.scale = point, (radius,) * 3
    # Grey: on black, what resampling overshoots would be cut off on one side.
    bpy.context.scene.world = make_luminous(
        bpy.data.worlds.new("sky"), "ShaderNodeOutputWorld", 0.1
    )
    _set_up_render(job, threads=0)
    bpy.context.scene.cycles.use_denoising = False
    # Linear light: of a tone curve's output the centre of light would not be that of the disc.
    bpy.context.scene.view_settings.view_transform = "Raw"
    with tempfile.TemporaryDirectory() as scratch:
        picture = _render(pose, np.zeros(3), Path(scratch), np.zeros(1, np.int64))["rgb"]
    if job.distorted_camera is not None:
        c = job.camera
        picture = resample_colour(picture, c.f * _camera_rays(job.distorted_camera) + [c.cx, c.cy])
    np.save(out, picture)


def make_luminous(item: bpy.types.ID, output: str, strength: float) -> bpy.types.ID:
    item.use_nodes = True
    tree = item.node_tree
    tree.nodes.clear()
    glow = tree.nodes.new("ShaderNodeEmission")
    glow.inputs["Color"].default_value = (strength, strength, strength, 1.0)
    tree.links.new(glow.outputs[0], tree.nodes.new(output).inputs["Surface"])
    return item


if __name__ == "__main__":
    main(*sys.argv[1:])
