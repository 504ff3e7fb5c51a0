"""Render frames with Cycles in a process: ``python -m simulate.render.blender CHUNK.json``.

This is the only module that imports ``bpy``. The process prints one JSON line per finished frame to
standard output. Other output of Blender is discarded.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any, TextIO

import bpy
import numpy as np
import OpenEXR
from mathutils import Vector
from numpy.typing import NDArray
from PIL import Image

from objconnect.scene.runtime.memory import resident_bytes
from objconnect.scene.storage.scratch import scratch
from simulate.camera.pinhole import PinholeCamera
from simulate.camera.resample import resample, resample_values
from simulate.look import conditions
from simulate.look.conditions import Condition
from simulate.look.ground_images import GroundImages, bake_ground
from simulate.look.individual import individual_mesh
from simulate.look.lamps import Beam, beams
from simulate.look.light import add_light
from simulate.look.materials import RANDOM_KEY, build_materials
from simulate.look.mesh import Mesh
from simulate.look.props import shape_mesh
from simulate.look.terrain import ground_mesh, kerbs_mesh
from simulate.place.world import World
from simulate.render.board import board_mesh
from simulate.render.caster import Caster
from simulate.render.frame import (
    exposure_offset,
    pinhole_rays,
    row_shift,
    save_layers,
    semantic_labels,
    world_rays,
)
from simulate.render.job import Board, FrameDone, RenderChunk, RenderJob, frame_path
from simulate.render.precipitation import draw_precipitation
from simulate.render.process import end_with, keep_to_one_core
from simulate.render.rendered_world import build_world, find_ids
from simulate.render.shutter import roll_shutter
from simulate.render.stage import Stage, object_name
from simulate.render.window import move_pose
from simulate.thermal.camera import ThermalCamera

_SENSOR_MM = 36.0
# Cycles offsets the first ray of a pixel by this much (px) to the right and up, because it samples
# a table of its filter. The offset was measured by ray casting and is equal at every pixel.
_FIRST_RAY_PX = 0.000526
_NEAR_M = 0.1  # near clipping distance
_NO_SURFACE_M = 1e9  # Cycles writes a depth of 1e10 where a ray hits nothing


def main(chunk_path: str) -> None:
    """Render the frames of a ``RenderChunk`` file that do not exist yet."""
    reports = _claim_stdout()
    chunk = RenderChunk.model_validate_json(Path(chunk_path).read_text())
    end_with(chunk.parent)
    if chunk.threads == 1:
        keep_to_one_core()
    job = chunk.job
    world = stage = condition = thermal = None
    x = y = 0.0
    if job.board is not None:
        _build_board(job.board)
    else:
        world, (x, y) = build_world(job)
        condition = conditions.condition(job.condition, job.origin)
        thermal = _thermal_camera(job, world, condition, _build_scene(world, condition, (x, y)))
        stage = Stage(bpy.context.scene, world, condition, _add_beams(world, condition))
    _set_up_render(job, chunk.threads)
    bpy.context.scene.cycles.use_denoising = job.board is None  # denoising shifts edges of a board
    rays = pinhole_rays(job.camera) if chunk.rays is None else np.load(chunk.rays)
    bpy.context.view_layer.update()
    caster = Caster(bpy.context.scene.objects, _NEAR_M)
    first_bytes = None  # memory after the first frame
    with scratch(Path(chunk_path).parent) as folder:
        for frame, rows in job.poses.items():
            path = frame_path(chunk.out_dir, frame)
            if path.exists():
                continue
            start = time.monotonic()
            pose = move_pose(np.asarray(rows, float), (x, y))
            # The noise depends on the job's seed and the frame's number, not on process or order.
            state = np.random.SeedSequence([job.seed, frame]).generate_state(1)[0]
            bpy.context.scene.cycles.seed = int(state >> 1)
            travel = np.array(job.travel.get(frame, (0.0, 0.0, 0.0)))
            if stage is not None:
                stage.set_up(job.camera, pose, float(np.linalg.norm(travel)))
            ids = np.zeros(1, np.int64) if stage is None else stage.ids
            arrays = _render(pose, travel, folder, ids)
            if condition is not None:
                rng = np.random.default_rng([job.seed, frame, 6])
                arrays["rgb"] = draw_precipitation(arrays["rgb"], job.camera, pose, condition, rng)
            radiance = None
            if thermal is not None and world is not None:
                radiance = _radiance(thermal, world, job.camera, pose, travel, arrays)
            if chunk.rays is not None:
                c = job.camera
                xy, boxes = c.f * rays + [c.cx, c.cy], caster.small_object_boxes(pose, c.f)
                arrays = resample(arrays, xy, rays, caster.cast_from(pose), boxes)
                radiance = None if radiance is None else resample_values(radiance, xy)
            if world is not None:
                shift = row_shift(travel, len(rays))
                arrays["semantic"] = semantic_labels(world, rays, pose, shift, arrays)
            if radiance is not None:
                arrays["thermal"] = radiance
            save_layers(path, arrays)
            done = FrameDone(frame=frame, seconds=round(time.monotonic() - start, 3))
            print(done.model_dump_json(), file=reports, flush=True)
            first_bytes = first_bytes or resident_bytes()
            if resident_bytes() - first_bytes >= chunk.max_growth_bytes:
                break


def _claim_stdout() -> TextIO:
    """Return the real standard output, and redirect descriptor 1 to the null device."""
    reports = os.fdopen(os.dup(1), "w")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)
    return reports


# --- the scene ---------------------------------------------------------------------------------


def _build_scene(
    world: World, condition: Condition, origin: tuple[float, float] = (0.0, 0.0)
) -> GroundImages:
    """Add the world under a condition to an empty Blender file, and return its ground."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    images = bake_ground(world, condition)
    materials = build_materials(bpy.data, condition, *images, world.seed, origin)
    # Meshes come first, because adding a material to a mesh slows down with existing objects.
    grounds = {"terrain": ground_mesh(world, condition), "kerbs": kerbs_mesh(world)}
    surfaces = [
        _mesh_data(name, surface, materials)
        for name, surface in grounds.items()
        if surface is not None
    ]
    shared: dict[str, Any] = {}
    meshes = []
    for item in world.objects:
        individual = individual_mesh(item, world)
        if individual is not None:
            meshes.append(_mesh_data(object_name(item.id), individual, materials))
            continue
        if item.shape not in shared:
            shared[item.shape] = _mesh_data(item.shape, shape_mesh(item.shape), materials)
        meshes.append(shared[item.shape])
    for surface in surfaces:
        _add(surface.name, surface)
    for item, data in zip(world.objects, meshes, strict=True):
        # Blender sorts objects by name; ascending names are fast to insert.
        placed = _add(object_name(item.id), data)
        placed.location = item.centre
        placed.rotation_euler = (0.0, 0.0, item.yaw)
        placed.color = (*item.colour, float(item.driven))
        if data is shared.get(item.shape):
            placed.scale = item.size
        if item.class_name == "building":  # the origin of its mesh is at the ground
            placed.location.z -= 0.5 * item.size[2]
            placed[RANDOM_KEY] = item.random_key
    add_light(bpy.data, bpy.context.scene, condition)
    return images


def _thermal_camera(
    job: RenderJob, world: World, condition: Condition, ground_images: GroundImages
) -> ThermalCamera | None:
    """Return the thermal camera of a job, and make Cycles write the passes that it reads."""
    if not job.thermal:
        return None
    layer = bpy.context.scene.view_layers[0]
    layer.use_pass_material_index = layer.use_pass_uv = True
    names = sorted(material.name for material in bpy.data.materials)
    for number, name in enumerate(names, 1):
        bpy.data.materials[name].pass_index = number
    return ThermalCamera(world, condition, job.origin, names, ground_images)


def _build_board(board: Board) -> None:
    """Add a self-luminous chessboard on a grey ground to an empty Blender file."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    materials: dict[str, Any] = {}
    for name, shade in (("white", 0.8), ("black", 0.02), ("grey", 0.3)):
        materials[name] = bpy.data.materials.new(name)
        materials[name].use_nodes = True
        tree = materials[name].node_tree
        tree.nodes.clear()
        glow = tree.nodes.new("ShaderNodeEmission")
        glow.inputs["Color"].default_value = (shade, shade, shade, 1.0)
        output = tree.nodes.new("ShaderNodeOutputMaterial")
        tree.links.new(glow.outputs[0], output.inputs["Surface"])
    _add("board", _mesh_data("board", board_mesh(board), materials))


def _mesh_data(name: str, mesh: Mesh, materials: dict[str, Any]) -> Any:
    """Make a Blender mesh with its materials and the attributes that they read."""
    data = bpy.data.meshes.new(name)
    data.vertices.add(len(mesh.vertices))
    data.vertices.foreach_set("co", mesh.vertices.ravel())
    data.loops.add(len(mesh.corners))
    data.loops.foreach_set("vertex_index", mesh.corners)
    data.polygons.add(len(mesh.sizes))
    starts = np.concatenate([[0], np.cumsum(mesh.sizes)[:-1]]).astype(np.int32)
    data.polygons.foreach_set("loop_start", starts)
    data.polygons.foreach_set("material_index", mesh.material)
    if mesh.uv.any():
        data.uv_layers.new(name="uv").data.foreach_set("uv", mesh.uv.ravel())
    tint = data.attributes.new("tint", "FLOAT_COLOR", "FACE")
    tint.data.foreach_set("color", np.insert(mesh.tint, 3, 1.0, axis=1).ravel())
    for material in mesh.materials:
        data.materials.append(materials[material])
    data.update(calc_edges=True)
    return data


def _add(name: str, data: Any) -> Any:
    """Add an object to the Blender scene."""
    item = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(item)
    return item


def _add_beams(world: World, condition: Condition) -> list[tuple[Beam, Any]]:
    """Add the lamps of a night, and return each beam with its light."""
    if condition.night is None:
        return []
    return [(beam, _add_beam(f"beam {k:05d}", beam)) for k, beam in enumerate(beams(world))]


def _add_beam(name: str, beam: Beam) -> Any:
    """Add a spot light, which the camera does not see, and return it."""
    lamp = bpy.data.lights.new(name, "SPOT")
    lamp.color = beam.rgb
    lamp.spot_size, lamp.spot_blend, lamp.shadow_soft_size = np.radians(beam.cone_deg), 0.8, 0.0
    placed = _add(name, lamp)
    placed.location = beam.position
    # Spot lights shine along -z; their cone is flattened along y.
    placed.rotation_euler = Vector(beam.direction).to_track_quat("-Z", "Y").to_euler()
    placed.scale = (1.0, beam.aspect, 1.0)
    placed.visible_camera = False
    return lamp


# --- the camera and the renderer -----------------------------------------------------------------


def _set_up_render(job: RenderJob, threads: int) -> None:
    """Set the camera's intrinsics and all settings of Cycles that change the pixels."""
    scene, camera = bpy.context.scene, job.camera
    data = bpy.data.cameras.new("camera")
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = _SENSOR_MM
    data.lens = camera.f * _SENSOR_MM / camera.width
    data.shift_x = (0.5 * camera.width - camera.cx - _FIRST_RAY_PX) / camera.width
    data.shift_y = (camera.cy - _FIRST_RAY_PX - 0.5 * camera.height) / camera.width
    data.clip_start, data.clip_end = _NEAR_M, 1e4
    scene.camera = _add("camera", data)
    scene.camera.rotation_mode = "QUATERNION"

    render = scene.render
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y = camera.width, camera.height
    render.resolution_percentage = 100
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0
    render.use_persistent_data = True
    render.dither_intensity = 0.0
    if threads > 0:
        render.threads_mode, render.threads = "FIXED", threads
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.look = "AgX - Base Contrast"

    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.samples = job.samples
    cycles.use_adaptive_sampling = False
    cycles.use_animated_seed = False
    cycles.use_light_tree = False
    cycles.max_bounces = 2
    cycles.diffuse_bounces, cycles.glossy_bounces = 1, 1
    cycles.caustics_reflective = cycles.caustics_refractive = False
    cycles.use_denoising = True
    cycles.denoiser = "OPENIMAGEDENOISE"
    # Fast guides take 3.0 instead of 5.4 CPU-seconds per frame at the same visual quality.
    cycles.denoising_prefilter = "FAST"
    cycles.denoising_quality = job.denoising.upper()
    layer = scene.view_layers[0]
    layer.use_pass_z = layer.use_pass_normal = layer.use_pass_object_index = True


def _render(
    cam_from_world: NDArray[np.float64],
    travel: NDArray[np.float64],
    folder: Path,
    ids: NDArray[np.int64],
) -> dict[str, NDArray[Any]]:
    """Render rgb, depth, instance and normal of one frame.

    The camera moves by ``travel`` (3,) metres while the frame is read out. ``ids`` are the ids of
    objects by their pass index.
    """
    scene = bpy.context.scene
    world_from_cam = np.linalg.inv(cam_from_world)
    # Blender's camera looks along -z with y up.
    scene.camera.matrix_world = (world_from_cam @ np.diag([1.0, -1.0, -1.0, 1.0])).T.tolist()
    roll_shutter(scene, travel)
    settings = scene.render.image_settings
    settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    settings.exr_codec = "NONE"
    scene.render.filepath = str(folder / "passes.exr")
    bpy.ops.render.render(write_still=True)
    # An uncompressed TIFF takes two thirds of the time of an uncompressed PNG.
    settings.file_format, settings.color_depth, settings.color_mode = "TIFF", "8", "RGB"
    settings.tiff_codec = "NONE"
    picture = str(folder / "picture.tif")
    bpy.data.images["Render Result"].save_render(picture, scene=scene)

    with OpenEXR.File(str(folder / "passes.exr"), separate_channels=True) as exr:
        channels = {name.split(".", 1)[1]: c.pixels for name, c in exr.channels().items()}
    depth = channels["Depth.Z"]
    # Cycles measures depth from the frame's pose, but each row has a camera position of its own.
    offset = row_shift(travel, len(depth)) + exposure_offset(travel, len(depth))
    ahead = offset @ cam_from_world[2, :3]
    depth = np.where(depth < _NO_SURFACE_M, depth - ahead[:, None], 0)
    normal = np.stack([channels[f"Normal.{axis}"] for axis in "XYZ"], -1)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-6)
    layers = {
        "rgb": np.asarray(Image.open(picture).convert("RGB")),
        "depth": depth.astype(np.float32),
        "instance": find_ids(channels["IndexOB.X"], ids),
        "normal": np.rint(127 * normal).astype(np.int8),
    }
    if "IndexMA.X" in channels:
        layers["material"] = np.rint(channels["IndexMA.X"]).astype(np.uint8)
        layers["uv"] = np.stack([channels[f"UV.{axis}"] for axis in "UV"], -1)
    return layers


def _radiance(
    thermal: ThermalCamera,
    world: World,
    camera: PinholeCamera,
    cam_from_world: NDArray[np.float64],
    travel: NDArray[np.float64],
    layers: dict[str, NDArray[Any]],
) -> NDArray[np.float32]:
    """Return the radiance (H, W) of a frame, and remove the layers that only this step needs."""
    rays, shift = pinhole_rays(camera), row_shift(travel, camera.height)
    semantic = semantic_labels(world, rays, cam_from_world, shift, layers)
    view = {**layers, "semantic": semantic}
    del layers["material"], layers["uv"]
    return thermal(view, *world_rays(rays, cam_from_world, shift))


if __name__ == "__main__":
    main(sys.argv[1])
