"""Animate Blender's camera for a rolling shutter."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulate.render.frame import exposure_offset


def roll_shutter(scene: Any, travel: NDArray[np.float64]) -> None:
    """Animate the camera for a rolling shutter with ``travel`` (3,) metres over the picture.

    The middle row is exposed at the camera's current position.
    """
    camera, moves = scene.camera, bool(travel.any())
    # Assigning these properties makes Cycles reload the scene for 0.3 s, even if nothing changes.
    if camera.animation_data is not None:
        camera.animation_data_clear()
    if scene.render.use_motion_blur != moves:
        scene.render.use_motion_blur = moves
    if not moves:
        return
    scene.render.motion_blur_shutter = 1.0  # from half a frame before to half a frame after
    scene.render.motion_blur_position = "CENTER"
    scene.cycles.rolling_shutter_type = "TOP"
    scene.cycles.rolling_shutter_duration = 0.0  # row by row and without streaks
    now = scene.frame_current
    # Cycles exposes every row ``exposure_offset`` too far along, so the path begins earlier.
    keyed = np.array(camera.location) - exposure_offset(travel, scene.render.resolution_y)
    for step in (-1, 1):
        camera.location = keyed + step * travel
        camera.keyframe_insert("location", frame=now + step)
    for curve in camera.animation_data.action.fcurves:
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"
