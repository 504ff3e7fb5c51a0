"""Poses of Agisoft Metashape: the XML that "Export Cameras" writes.

A camera's ``transform`` is a row-major matrix, chunk from camera, with OpenCV's camera axes. The
transform of the component (or, in older files, of the chunk) leads from the chunk to geocentric
metres, or to a local system. The principal point ``cx``, ``cy`` is in pixels from the middle of the
picture, and pixels are COLMAP's: the centre of the top left one is (0.5, 0.5). ``b1`` is fx - fy,
``b2`` the skew, and ``p1`` and ``p2`` are those of OpenCV in the other order (Metashape
Professional's user manual, appendix "Camera models").
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scene.errors import InputError
from scene.geometry.camera import Camera
from scene.geometry.geodesy import Geodetic, enu_axes, geodetic_from_ecef
from scene.imports.lens import LARGEST_SIDE, BrownLens
from scene.imports.poses import ForeignPoses, Format, begins_with, posed
from scene.storage.files import read_text

Array = NDArray[np.float64]

# Distances from the middle of the earth (m) between which geocentric coordinates lie.
_ON_EARTH_M = (6.2e6, 6.6e6)
# The reader of a fisheye cannot bend its axes: a smaller coefficient moves no point by a pixel.
_NOTHING = 1e-9


def _read(path: Path) -> ForeignPoses:
    """Read the photographs that are aligned and enabled."""
    chunk = _parsed(path).find("chunk")
    if chunk is None:
        raise InputError(f"{path} has no chunk: export it with Metashape's Export Cameras")
    cameras = {sensor.get("id"): _camera(path, sensor) for sensor in chunk.iter("sensor")}
    world = {one.get("id"): _similarity(path, one) for one in chunk.iter("component")}
    whole = _similarity(path, chunk)
    names, lenses, matrices, placed = [], [], [], []
    for camera in chunk.iter("camera"):
        transform, name = camera.find("transform"), camera.get("label", "")
        if transform is None or camera.get("enabled", "true") in ("false", "0"):
            continue
        chunk_from_cam = _numbers(path, transform.text, 16, f"transform of {name!r}")
        similarity = world.get(camera.get("component_id"))
        similarity = whole if similarity is None else similarity
        names.append(name)
        lenses.append(cameras.get(camera.get("sensor_id")))
        matrices.append(_moved(chunk_from_cam.reshape(4, 4), similarity))
        placed.append(similarity is not None)
    if any(placed) and not all(placed):
        raise InputError(f"{path}: some photographs are in a component without a transform")
    world_from_cam, origin = _on_earth(np.array(matrices).reshape(-1, 4, 4))
    return posed(path, names, lenses, world_from_cam, origin)


def _parsed(path: Path) -> ET.Element:
    text = read_text(path, "Metashape's cameras")
    if "<!DOCTYPE" in text or "<!ENTITY" in text:  # entities can grow to any size
        raise InputError(f"{path} declares a document type, which Metashape does not write")
    try:
        return ET.fromstring(text)
    except (ET.ParseError, ValueError, RecursionError) as error:
        raise InputError(f"{path} is not valid XML: {error}") from None


def _numbers(path: Path, text: str | None, count: int, what: str) -> Array:
    """Return the numbers of an element's text, (count,)."""
    try:
        values = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(f"{path}: the {what} must be {count} numbers")
    return values


def _similarity(path: Path, holder: ET.Element) -> Array | None:
    """Return world from chunk of a component or chunk as (4, 4): scale, rotation, translation."""
    transform = holder.find("transform")
    if transform is None:
        return None
    rotation, shift, scale = (transform.find(part) for part in ("rotation", "translation", "scale"))
    matrix = np.eye(4)
    if rotation is not None:
        matrix[:3, :3] = _numbers(path, rotation.text, 9, "rotation").reshape(3, 3)
    if scale is not None:
        matrix[:3, :3] *= _numbers(path, scale.text, 1, "scale")[0]
    if shift is not None:
        matrix[:3, 3] = _numbers(path, shift.text, 3, "translation")
    return matrix


def _moved(chunk_from_cam: Array, world_from_chunk: Array | None) -> Array:
    """Return world from camera, (4, 4), whose rotation has no scale."""
    if world_from_chunk is None:
        return chunk_from_cam
    moved = np.asarray(world_from_chunk @ chunk_from_cam)
    scale = np.cbrt(np.linalg.det(world_from_chunk[:3, :3]))
    moved[:3, :3] /= scale if scale > 0 else np.nan
    return moved


def _on_earth(world_from_cam: Array) -> tuple[Array, Geodetic | None]:
    """Return geocentric poses as east, north, up around their middle; others as they are."""
    if not len(world_from_cam):
        return world_from_cam, None
    middle = np.median(world_from_cam[:, :3, 3], axis=0)
    if not _ON_EARTH_M[0] < float(np.linalg.norm(middle)) < _ON_EARTH_M[1]:
        return world_from_cam, None
    origin = geodetic_from_ecef(middle)
    enu_from_ecef = np.eye(4)
    enu_from_ecef[:3, :3] = enu_axes(origin)
    enu_from_ecef[:3, 3] = -enu_axes(origin) @ middle
    return np.asarray(enu_from_ecef @ world_from_cam), origin


def _camera(path: Path, sensor: ET.Element) -> Camera | None:
    """Return the camera of a sensor: its adjusted calibration, else its first one."""
    found = sensor.findall("calibration")
    if not found:
        return None
    calibration = next((one for one in found if one.get("class") == "adjusted"), found[0])
    label = sensor.get("label", "")
    size = _first(calibration.findall("resolution"), sensor.findall("resolution"))
    try:
        width, height = int(size.get("width", "0")), int(size.get("height", "0"))
    except ValueError:
        width = height = 0
    part = {
        name: _numbers(path, text, 1, f"{name} of sensor {label!r}")[0]
        for name in ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
        if (text := calibration.findtext(name)) is not None
    }
    try:
        if "f" not in part:
            raise InputError("no focal length f")
        if max(width, height) > LARGEST_SIDE:
            raise InputError(f"no picture is {width} x {height} pixels")
        if part.get("p3") or part.get("p4"):
            raise InputError("the coefficients p3 and p4 are not supported")
        return _lens(calibration.get("type", "frame"), (width, height), part)
    except InputError as error:
        raise InputError(f"{path}: sensor {label!r}: {error}") from None


def _first(*found: Iterable[ET.Element]) -> ET.Element:
    return next((element for part in found for element in part), ET.Element("resolution"))


def _lens(kind: str, size: tuple[int, int], part: dict[str, np.float64]) -> Camera:
    """Return the camera of a calibration.

    Raises:
        InputError: the kind is not supported, or the numbers are those of no camera.
    """
    f, b1, b2, p1, p2 = (float(part.get(name, 0.0)) for name in ("f", "b1", "b2", "p1", "p2"))
    k1, k2, k3, k4 = (float(part.get(name, 0.0)) for name in ("k1", "k2", "k3", "k4"))
    cx, cy = (
        float(part.get(name, 0.0)) + side / 2 for name, side in zip(("cx", "cy"), size, strict=True)
    )
    if kind == "frame":
        radial = (k1, k2, k3, k4)
        return BrownLens(size, (f + b1, f), (cx, cy), radial, (p2, p1), b2).camera()
    if kind != "fisheye":
        raise InputError(f"cameras of type {kind!r} are not supported")
    if max(abs(b2), abs(p1), abs(p2)) > _NOTHING:
        raise InputError("a fisheye with b2, p1 or p2 is not supported: fix them at 0")
    return Camera("OPENCV_FISHEYE", *size, (f + b1, f, cx, cy, k1, k2, k3, k4))


FORMAT = Format(
    lambda path: path.suffix.lower() == ".xml" and begins_with(path, "<"),
    _read,
    "a cameras.xml of Metashape",
)
