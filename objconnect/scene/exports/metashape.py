"""Export to Agisoft Metashape: ``cameras.xml``, for File > Import > Import Cameras.

Metashape matches cameras by their labels, which are file names without suffixes. The chunk is the
east-north-up world in metres; the component's transform maps it to geocentric metres. The
conventions are those of ``objconnect.scene.imports.metashape``.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from objconnect.scene.bundle.frames import Frames
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.exports.flat_names import flat_names
from objconnect.scene.exports.lens import coefficients
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import ecef_from_geodetic, enu_axes

# Latitude, longitude and ellipsoidal height, as Metashape writes the system.
_WGS84 = (
    'GEOGCS["WGS 84",DATUM["World Geodetic System 1984",'
    'SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],'
    'TOWGS84[0,0,0,0,0,0,0],AUTHORITY["EPSG","6326"]],'
    'PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],'
    'UNIT["degree",0.01745329251994328,AUTHORITY["EPSG","9102"]],AUTHORITY["EPSG","4326"]]'
)


def write(scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path) -> None:
    """Write ``cameras.xml``; see ``formats.Writer``.

    Raises:
        InputError: two photographs have the same label, a label has white space, or a lens has a
            rational distortion (k4, k5 or k6).
    """
    names, origin = flat_names(sessions, stems=True), scene.manifest.origin
    cameras = list(dict.fromkeys(c for frames in sessions.values() for c in frames.cameras))
    document = ET.Element("document", version="2.0.0")
    chunk = ET.SubElement(document, "chunk", label=scene.name, enabled="true")
    sensors = ET.SubElement(chunk, "sensors", next_id=str(len(cameras)))
    for k, camera in enumerate(cameras):
        _add_sensor(sensors, k, camera)
    components = ET.SubElement(chunk, "components", next_id="1", active_id="0")
    component = ET.SubElement(components, "component", id="0", label="Component 1")
    transform = ET.SubElement(component, "transform")
    _add(transform, "rotation", enu_axes(origin).T.ravel().tolist())
    _add(transform, "translation", ecef_from_geodetic(origin).tolist())
    _add(transform, "scale", [1.0])
    entries = ET.SubElement(chunk, "cameras", next_id=str(len(names)), next_group_id="0")
    for frames in sessions.values():
        matrices = frames.poses.inverse().matrix().numpy()
        for name, camera, matrix in zip(frames.names, frames.cameras, matrices, strict=True):
            entry = ET.SubElement(
                entries,
                "camera",
                id=str(len(entries)),
                sensor_id=str(cameras.index(camera)),
                component_id="0",
                label=names[name],
            )
            _add(entry, "transform", np.asarray(matrix).ravel().tolist())
    ET.SubElement(chunk, "reference").text = _WGS84
    ET.indent(document)
    ET.ElementTree(document).write(folder / "cameras.xml", encoding="utf-8", xml_declaration=True)


def _add_sensor(sensors: ET.Element, number: int, camera: Camera) -> None:
    (fx, fy), (cx, cy) = camera.focal, camera.principal
    kind = "fisheye" if camera.is_fisheye else "frame"
    names = ("k1", "k2", "k3", "k4") if camera.is_fisheye else ("k1", "k2", "k3", "p2", "p1")
    distortion = coefficients(camera, names, "cameras.xml of Metashape")
    if not camera.is_fisheye:  # Metashape's p1 and p2 are OpenCV's in reverse order.
        distortion["p1"], distortion["p2"] = distortion["p2"], distortion["p1"]
    values = {
        "f": fy,
        "cx": cx - camera.width / 2,
        "cy": cy - camera.height / 2,
        "b1": fx - fy,
        **distortion,
    }
    sensor = ET.SubElement(sensors, "sensor", id=str(number), label=f"camera {number}", type=kind)
    size = {"width": str(camera.width), "height": str(camera.height)}
    ET.SubElement(sensor, "resolution", size)
    calibration = ET.SubElement(sensor, "calibration", {"type": kind, "class": "adjusted"})
    ET.SubElement(calibration, "resolution", size)
    for name, value in values.items():
        _add(calibration, name, [value])


def _add(parent: ET.Element, name: str, numbers: Iterable[float]) -> None:
    ET.SubElement(parent, name).text = " ".join(repr(number) for number in numbers)
