"""Add the light of a condition (season, time of day, weather) to a Blender scene.

The function receives Blender's data and does not import ``bpy``, which only the renderer needs.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from simulate.look.conditions import Condition


def add_light(data: Any, scene: Any, condition: Condition) -> None:
    """Add the sun, or the moon by night, and a sky that is brighter towards the horizon.

    Args:
        data: ``bpy.data``.
        scene: The Blender scene.
        condition: The condition. Its exposure is set in the scene too.
    """
    lamp, sun = data.lights.new("sun", "SUN"), condition.luminary
    lamp.energy, lamp.color, lamp.angle = sun.watts, sun.rgb, np.radians(sun.angle)
    elevation, azimuth = np.radians([sun.elevation, sun.azimuth])
    placed = data.objects.new("sun", lamp)
    scene.collection.objects.link(placed)
    placed.rotation_euler = (0.5 * np.pi - elevation, 0.0, np.pi - azimuth)

    sky = data.worlds.new("sky")
    scene.world = sky
    sky.use_nodes = True
    tree = sky.node_tree
    tree.nodes.clear()
    direction = tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"]
    split = tree.nodes.new("ShaderNodeSeparateXYZ")
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    background = tree.nodes.new("ShaderNodeBackground")
    output = tree.nodes.new("ShaderNodeOutputWorld")
    ramp.color_ramp.elements[0].color = (*condition.sky.horizon, 1.0)
    ramp.color_ramp.elements[1].color = (*condition.sky.zenith, 1.0)
    ramp.color_ramp.elements[1].position = 0.6
    background.inputs["Strength"].default_value = condition.sky.strength
    tree.links.new(direction, split.inputs[0])
    tree.links.new(split.outputs["Z"], ramp.inputs["Fac"])
    tree.links.new(ramp.outputs["Color"], background.inputs["Color"])
    tree.links.new(background.outputs[0], output.inputs["Surface"])
    # Rays from surfaces sample a smooth sky well. If it were sampled as a lamp, half of the shadow
    # rays would go to the sky instead of the sun, rendering would take a third longer, and the
    # picture would be noisier.
    sky.cycles.sampling_method = "NONE"
    scene.view_settings.exposure = condition.exposure
