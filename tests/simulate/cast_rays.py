"""Cast Blender's rays at the scene of a render job: `python -m tests.simulate.cast_rays JOB OUT`.

OUT is npz of arrays (F, M): pixel columns and rows of the photograph, and what the ray through each
pixel's centre meets: planar depth in metres and object id, zero where it meets nothing.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from simulate.look.conditions import condition
from simulate.render.blender import _build_scene
from simulate.render.frame import pinhole_rays
from simulate.render.job import RenderJob
from simulate.render.pool import _camera_rays
from simulate.render.rendered_world import build_world
from simulate.render.stage import parse_object_name
from simulate.render.window import move_pose

PIXELS = 1000


def main(job_path: str, out: str) -> None:
    job = RenderJob.model_validate_json(Path(job_path).read_text())
    world, origin = build_world(job)
    _build_scene(world, condition(job.condition), origin)
    graph = bpy.context.evaluated_depsgraph_get()
    rays = (
        pinhole_rays(job.camera)
        if job.distorted_camera is None
        else _camera_rays(job.distorted_camera)
    )
    height, width = rays.shape[:2]
    rng = np.random.default_rng(0)
    found = {name: np.zeros((len(job.poses), PIXELS)) for name in ("depth", "instance")}
    pixels = rng.integers(0, [width, height], (len(job.poses), PIXELS, 2))
    for f, rows in enumerate(job.poses.values()):
        cam_from_world = move_pose(np.array(rows), origin)
        rotation, centre = cam_from_world[:3, :3], np.linalg.inv(cam_from_world)[:3, 3]
        for k, (column, row) in enumerate(pixels[f]):
            ray = np.array([*rays[row, column], 1.0])
            hit, at, _, _, item, _ = bpy.context.scene.ray_cast(
                graph, Vector(centre), Vector(ray @ rotation)
            )
            if hit:
                found["depth"][f, k] = (rotation @ (np.array(at) - centre))[2]
                found["instance"][f, k] = parse_object_name(item.name)
    np.savez(out, columns=pixels[..., 0], rows=pixels[..., 1], **found)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
