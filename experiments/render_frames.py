"""Render one frame per line of standard input: `python -m experiments.render_frames JOB OUT`.

A line is a kind and the number of a frame. "bare": Blender renders and writes only the picture.
"ours": the frame with all its layers, as ``simulate`` writes it. Three more kinds each leave out
one more part of the bare picture: "raw" the denoiser, "flat" also all light (every surface is
emissive, so that a ray ends at its first hit), "still" also all pixels but a few (which leaves
loading the scene and calling Blender). Settings of Blender's scene may follow for this frame only,
such as cycles.max_bounces=1. Pictures are OUT/bare.png. The answer is the processor seconds of all
threads, which depend less on other work than wall-clock time, and the resident bytes of the
process.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import reduce
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import yaml

from objconnect.scene.runtime.memory import resident_bytes
from simulate.look.conditions import condition
from simulate.place.presets import preset
from simulate.render.blender import (
    _build_scene,
    _claim_stdout,
    _render,
    _set_up_render,
)
from simulate.render.frame import pinhole_rays, save_layers, semantic_labels
from simulate.render.job import RenderJob, frame_path
from simulate.render.stage import Stage


def main(job_path: str, out: str) -> None:
    """Answer each line of standard input."""
    answers = _claim_stdout()
    job = RenderJob.model_validate_json(Path(job_path).read_text())
    world = preset(job.preset)(job.seed, job.side_m)
    light = condition(job.condition)
    _build_scene(world, light)
    _set_up_render(job, 0)
    stage = Stage(bpy.context.scene, world, light, [])
    scene = bpy.context.scene
    layer, rays, glow = scene.view_layers[0], pinhole_rays(job.camera), _glow()
    with tempfile.TemporaryDirectory() as scratch:
        for line in sys.stdin:
            kind, number, *settings = line.split()
            ours = kind == "ours"
            for each in ("use_pass_z", "use_pass_normal", "use_pass_object_index"):
                _put(layer, each, ours)
            _put(scene.cycles, "use_denoising", kind in ("ours", "bare"))
            _put(layer, "material_override", glow if kind in ("flat", "still") else None)
            _put(scene.render, "resolution_percentage", 1 if kind == "still" else 100)
            pose = np.array(job.poses[int(number)])
            with _change_settings(scene, settings):
                start = time.process_time()
                if ours:
                    scene.cycles.seed = int(number)
                    stage.set_up(job.camera, pose, 0.0)
                    arrays = _render(pose, np.zeros(3), Path(scratch), stage.ids)
                    arrays["semantic"] = semantic_labels(
                        world, rays, pose, np.zeros((len(rays), 3)), arrays
                    )
                    save_layers(frame_path(Path(out), int(number)), arrays)
                else:
                    _render_picture(pose, Path(out))
                took = time.process_time() - start
            print(took, resident_bytes(), file=answers, flush=True)


def _put(owner: Any, name: str, value: Any) -> None:
    """Set a property if its value differs, because setting it makes Cycles reload the scene."""
    if getattr(owner, name) != value:
        setattr(owner, name, value)


@contextmanager
def _change_settings(scene: Any, settings: Sequence[str]) -> Iterator[None]:
    """Change settings, each as path=value, and set them back."""
    before = []
    for setting in settings:
        path, _, value = setting.partition("=")
        *owners, name = path.split(".")
        owner = reduce(getattr, owners, scene)
        before.append((owner, name, getattr(owner, name)))
        setattr(owner, name, yaml.safe_load(value))
    try:
        yield
    finally:
        for owner, name, value in reversed(before):
            setattr(owner, name, value)


def _glow() -> Any:
    """Return an emissive material that lights nothing else."""
    material = bpy.data.materials.new("glow")
    material.use_nodes = True
    material.cycles.emission_sampling = "NONE"
    tree = material.node_tree
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(tree.nodes.new("ShaderNodeEmission").outputs[0], output.inputs["Surface"])
    return material


def _render_picture(cam_from_world: np.ndarray, scratch: Path) -> None:
    scene = bpy.context.scene
    axes = np.diag([1.0, -1.0, -1.0, 1.0])
    scene.camera.matrix_world = (np.linalg.inv(cam_from_world) @ axes).T.tolist()
    settings = scene.render.image_settings
    settings.file_format, settings.color_depth, settings.color_mode = "PNG", "8", "RGB"
    settings.compression = 0
    scene.render.filepath = str(scratch / "bare.png")
    bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
