"""Reader of calibrations of Agisoft Metashape.

The principal point ``cx``, ``cy`` is in COLMAP pixels from the middle of the picture. ``b1`` is
fx - fy, ``b2`` the skew, and ``p1`` and ``p2`` are OpenCV's in reverse order (Metashape
Professional's user manual, appendix "Camera models"). Metashape omits coefficients that are zero.
"""

from __future__ import annotations

import logging
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.imports.lens import LARGEST_SIDE, BrownLens, require_inside

log = logging.getLogger(__name__)

# Fisheye cameras have no skew and no tangential distortion; smaller values have no visible effect.
_NEGLIGIBLE: Final = 1e-9
_PARAMETERS: Final = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2")
# Elements of a calibration that are not lens parameters.
_OTHER_ELEMENTS: Final = ("resolution", "covariance", "date", "correlation")


def parse_numbers(
    path: Path, element: ET.Element | None, count: int, what: str
) -> NDArray[np.float64]:
    """Return the numbers of an element's text, (count,).

    Raises:
        InputError: there are not ``count`` numbers, or one is not finite.
    """
    text = None if element is None else element.text
    try:
        values = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(f"{path}: the {what} must be {count} finite numbers")
    return values


def parse_camera(path: Path, sensor: ET.Element) -> Camera | None:
    """Return the camera of a sensor, from its adjusted calibration or else its first one.

    It is None if the sensor has no calibration.

    Raises:
        InputError: the lens is not supported, or values contradict each other.
    """
    calibrations = sensor.findall("calibration")
    if not calibrations:
        return None
    label = sensor.get("label", "")
    adjusted = next((one for one in calibrations if one.get("class") == "adjusted"), None)
    calibration = calibrations[0] if adjusted is None else adjusted
    if adjusted is None and calibration.get("class") == "initial":
        log.warning("%s: sensor %r has an initial calibration, not an adjusted one", path, label)
    where = f"sensor {label!r}"
    try:
        size = _size(sensor, calibration)
        return _make_camera(_kind(sensor, calibration), size, _parameters(path, calibration, where))
    except InputError as error:
        message = str(error)
        raise InputError(message if where in message else f"{path}: {where}: {message}") from None


def _parameters(path: Path, calibration: ET.Element, where: str) -> dict[str, float]:
    params = {}
    for element in calibration:
        if element.tag in _OTHER_ELEMENTS:
            continue
        if element.tag in _PARAMETERS:
            what = f"{element.tag} of {where}"
            params[element.tag] = float(parse_numbers(path, element, 1, what)[0])
        elif (element.text or "").strip() not in ("", "0"):
            raise InputError(f"the coefficient {element.tag} is not supported")
    if "f" not in params:
        raise InputError("no focal length f")
    return params


def _size(sensor: ET.Element, calibration: ET.Element) -> tuple[int, int]:
    """Return width and height; sensor and calibration must agree."""
    sizes = []
    for holder in (calibration, sensor):
        element = holder.find("resolution")
        if element is None:
            continue
        try:
            sizes.append((int(element.get("width", "")), int(element.get("height", ""))))
        except ValueError:
            raise InputError("its resolution has no width and height in pixels") from None
    if not sizes:
        raise InputError("no resolution")
    if sizes[0] != sizes[-1]:
        (w, h), (width, height) = sizes
        raise InputError(
            f"its resolution {width} x {height} and that of its calibration, {w} x {h}, contradict "
            "each other"
        )
    if max(sizes[0]) > LARGEST_SIDE:
        raise InputError(f"its resolution {sizes[0][0]} x {sizes[0][1]} is too large for a picture")
    return sizes[0]


def _kind(sensor: ET.Element, calibration: ET.Element) -> str:
    """Return the type of lens; sensor and calibration must agree."""
    kinds = [one.get("type") for one in (calibration, sensor)]
    stated = [kind for kind in kinds if kind is not None]
    if len(set(stated)) > 1:
        raise InputError(
            f"its type {stated[1]!r} and that of its calibration, {stated[0]!r}, contradict each "
            "other"
        )
    return stated[0] if stated else "frame"


def _make_camera(kind: str, size: tuple[int, int], params: dict[str, float]) -> Camera:
    """Return the camera of a calibration.

    Raises:
        InputError: the type is not supported, or the parameters are invalid.
    """
    f, b1, b2, p1, p2 = (params.get(name, 0.0) for name in ("f", "b1", "b2", "p1", "p2"))
    k1, k2, k3, k4 = (params.get(name, 0.0) for name in ("k1", "k2", "k3", "k4"))
    cx, cy = (
        params.get(name, 0.0) + side / 2 for name, side in zip(("cx", "cy"), size, strict=True)
    )
    require_inside((cx, cy), size, ("cx", "cy"))
    if kind == "frame":
        radial = (k1, k2, k3, k4)
        return BrownLens(size, (f + b1, f), (cx, cy), radial, (p2, p1), b2).camera()
    if kind != "fisheye":
        raise InputError(f"cameras of type {kind!r} are not supported")
    if max(abs(b2), abs(p1), abs(p2)) > _NEGLIGIBLE:
        raise InputError("a fisheye with b2, p1 or p2 is not supported: fix them at 0")
    return Camera("OPENCV_FISHEYE", *size, (f + b1, f, cx, cy, k1, k2, k3, k4))
