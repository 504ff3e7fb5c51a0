"""Reader of poses from Agisoft Metashape: the XML file of "Export Cameras".

A camera's ``transform`` is the row-major matrix chunk_from_cam with OpenCV's camera axes. The
transform of the component (in older files, of the chunk) maps the chunk to geocentric metres or to
a local system. Every chunk and every component has its own frame. ``metashape_lens`` reads
calibrations.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic, enu_axes, geodetic_from_ecef
from objconnect.scene.imports.metashape_lens import parse_camera, parse_numbers
from objconnect.scene.imports.poses import ForeignPoses, Format, begins_with, check_poses
from objconnect.scene.quantities.flags import parse_flag
from objconnect.scene.storage.files import read_text

Array = NDArray[np.float64]

# Range of distances (m) of geocentric coordinates from the earth's centre.
_ON_EARTH_M = (6.2e6, 6.6e6)


def _read(path: Path) -> ForeignPoses:
    """Read the aligned and enabled photographs."""
    chunk = _chunk(path)
    sensors = {sensor.get("id"): sensor for sensor in chunk.iter("sensor")}
    aligned = [camera for camera in chunk.iter("camera") if _is_aligned(camera)]
    # Unused sensors have an empty calibration.
    used = dict.fromkeys(camera.get("sensor_id") for camera in aligned)
    cameras = {name: parse_camera(path, sensors[name]) for name in used if name in sensors}
    transforms = _world_from_chunk(path, chunk, aligned)
    names, lenses, matrices = [], [], []
    for camera in aligned:
        name = camera.get("label", "")
        chunk_from_cam = parse_numbers(path, camera.find("transform"), 16, f"transform of {name!r}")
        chunk_from_cam = _require_last_row(path, chunk_from_cam.reshape(4, 4), name)
        names.append(name)
        lenses.append(cameras.get(camera.get("sensor_id")))
        matrices.append(_to_world(chunk_from_cam, transforms[camera.get("component_id")]))
    world_from_cam, origin = _localize_geocentric(np.array(matrices).reshape(-1, 4, 4))
    if origin is None and len(transforms) > 1:
        raise InputError(
            f"{path}: its photographs are in {len(transforms)} components, which have no common "
            "frame: export one component, or align and reference them together"
        )
    return check_poses(path, names, lenses, world_from_cam, origin)


def _chunk(path: Path) -> ET.Element:
    """Return the one chunk that has photographs."""
    chunks = list(_parse(path).iter("chunk"))
    if not chunks:
        raise InputError(f"{path} has no chunk: export it with Metashape's Export Cameras")
    with_photographs = [chunk for chunk in chunks if any(map(_is_aligned, chunk.iter("camera")))]
    if len(with_photographs) > 1:
        raise InputError(
            f"{path} has photographs in {len(with_photographs)} chunks, each with its own frame: "
            "export the cameras of one chunk"
        )
    return with_photographs[0] if with_photographs else chunks[0]


def _is_aligned(camera: ET.Element) -> bool:
    """Return whether a photograph has a pose and is enabled."""
    enabled = parse_flag(camera.get("enabled", "true"))
    return camera.find("transform") is not None and enabled is not False


def _world_from_chunk(
    path: Path, chunk: ET.Element, aligned: Sequence[ET.Element]
) -> dict[str | None, Array | None]:
    """Return world_from_chunk (4, 4) of each component with photographs; None for a local frame.

    Older files have one transform, that of the chunk.
    """
    by_component = {one.get("id"): _similarity(path, one) for one in chunk.iter("component")}
    used = dict.fromkeys(camera.get("component_id") for camera in aligned)
    transforms = {name: by_component.get(name) for name in used}
    if (
        not any(transform is not None for transform in by_component.values())
        and len(transforms) == 1
    ):
        return dict.fromkeys(transforms, _similarity(path, chunk))
    is_placed = [transform is not None for transform in transforms.values()]
    if any(is_placed) and not all(is_placed):
        raise InputError(
            f"{path}: some photographs are in a component without a transform: export one "
            "component, or align and reference them together"
        )
    return transforms


def _require_last_row(path: Path, matrix: Array, name: str) -> Array:
    if not np.allclose(matrix[3], [0.0, 0.0, 0.0, 1.0], rtol=0, atol=1e-6):
        raise InputError(f"{path}: the transform of {name!r} does not end with the row 0 0 0 1")
    return matrix


def _parse(path: Path) -> ET.Element:
    text = read_text(path, "Metashape's cameras")
    if "<!DOCTYPE" in text or "<!ENTITY" in text:  # entities can grow to any size
        raise InputError(f"{path} declares a document type, which Metashape does not write")
    try:
        return ET.fromstring(text)
    except (ET.ParseError, ValueError, RecursionError) as error:
        raise InputError(f"{path} is not valid XML: {error}") from None


def _similarity(path: Path, holder: ET.Element) -> Array | None:
    """Return world_from_chunk (4, 4) of a component or chunk: scale, rotation, translation."""
    transform = holder.find("transform")
    if transform is None or not len(transform):
        return None
    parts = {}
    for part, count in (("rotation", 9), ("translation", 3), ("scale", 1)):
        element = transform.find(part)
        if element is None:
            raise InputError(
                f"{path}: the transform of {holder.tag} {holder.get('label', '')!r} has no {part}"
            )
        parts[part] = parse_numbers(path, element, count, part)
    if not parts["scale"][0] > 0:
        raise InputError(f"{path}: the scale of {holder.tag} must be positive")
    matrix = np.eye(4)
    matrix[:3, :3] = parts["rotation"].reshape(3, 3) * parts["scale"][0]
    matrix[:3, 3] = parts["translation"]
    return matrix


def _to_world(chunk_from_cam: Array, world_from_chunk: Array | None) -> Array:
    """Return world_from_cam, (4, 4), with the scale removed from its rotation."""
    if world_from_chunk is None:
        return chunk_from_cam
    world_from_cam = np.asarray(world_from_chunk @ chunk_from_cam)
    scale = np.cbrt(np.linalg.det(world_from_chunk[:3, :3]))
    world_from_cam[:3, :3] /= scale if scale > 0 else np.nan
    return world_from_cam


def _localize_geocentric(world_from_cam: Array) -> tuple[Array, Geodetic | None]:
    """Convert geocentric poses to east, north, up from their median; others stay unchanged."""
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


FORMAT = Format(
    lambda path: path.suffix.lower() == ".xml" and begins_with(path, "<"),
    _read,
    "a cameras.xml of Metashape",
)
