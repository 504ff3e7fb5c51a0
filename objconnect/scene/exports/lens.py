"""Distortion coefficients of a camera for formats that hold only some of them."""

from __future__ import annotations

from collections.abc import Sequence

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import MODELS, Camera


def coefficients(camera: Camera, names: Sequence[str], file_format: str) -> dict[str, float]:
    """Return the distortion coefficients that a format holds, by COLMAP's names.

    Args:
        camera: the camera.
        names: coefficients of the format for such a lens; those that the camera lacks are 0.
        file_format: name of the format, for the error.

    Raises:
        InputError: a coefficient that the format lacks is not zero.

    Examples:
        >>> lens = Camera("SIMPLE_RADIAL", 640, 480, (500.0, 320.0, 240.0, -0.1))
        >>> coefficients(lens, ("k1", "k2"), "transforms.json")
        {'k1': -0.1, 'k2': 0.0}
    """
    params = dict(zip(MODELS[camera.model], camera.params, strict=True))
    distortion = {name: value for name, value in params.items() if name[0] in "kp"}
    lost = [name for name, value in distortion.items() if value and name not in names]
    if lost:
        raise InputError(
            f"{file_format} cannot hold {', '.join(lost)} of a camera of the model {camera.model}: "
            "export as colmap, or undistort the photographs"
        )
    return {name: distortion.get(name, 0.0) for name in names}
