"""``localize``: poses for new photographs, the everyday job."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.simulated import is_scene
from benchmark.textfiles import pose_line, read_priors
from scene.bundle import Scene
from scene.camera import Camera
from scene.colmap import read_map
from scene.errors import InputError
from scene.files import parse_json, read_text, write_text
from scene.geodesy import Geodetic, enu_from_geodetic, geodetic_from_enu
from scene.images import read_exif, read_rgb
from scene.localizer import Estimate, Localizer, Prior, Query, Status
from scene.progress import progress_bar
from scene.scratch import kept_or_scratch
from scene.sparse_map import SparseMap

_PHOTOGRAPHS = (".jpg", ".jpeg", ".png")
_WHERE = ("e", "n", "u", "latitude", "longitude", "altitude")
_COLUMNS = ("name", "status", *_WHERE, "sigma_m", "inliers", "reason")


@dataclass(frozen=True)
class Place:
    """A map, its photographs, and where on earth its origin lies (None when nobody knows)."""

    sparse_map: SparseMap
    images: Path
    origin: Geodetic | None


@dataclass(frozen=True)
class Located:
    """One photograph, the answer for it, and the camera's place where the origin is known."""

    name: str
    estimate: Estimate
    place: Geodetic | None

    @property
    def found(self) -> bool:
        """Whether the photograph was localized; a fallback is not."""
        return self.estimate.status is Status.OK and self.estimate.cam_from_world is not None


def open_place(path: Path) -> Place:
    """Open what new photographs are localized in: a scene with its map, or a flight.

    Raises:
        InputError: neither, or its map is missing, damaged or empty.
    """
    if is_scene(path):
        scene = Scene.open(path)
        return Place(scene.sparse_map(), scene.images_root, scene.manifest.origin)
    if (path / "sparse" / "map").is_dir():
        return Place(read_map(path / "sparse" / "map"), path / "images", _origin(path))
    raise InputError(f"{path} is no map: it is neither a scene nor a folder with sparse/map")


def localize(
    place: Place,
    photographs: Path,
    localizer: Localizer,
    out: Path,
    *,
    camera: Camera | None = None,
    priors: Path | None = None,
    gps_sigma_m: float = 10.0,
    cache: Path | None = None,
) -> list[Located]:
    """Localize every photograph of a folder and write ``out`` and, beside it, ``out`` as CSV.

    The text file has a line ``name qw qx qy qz tx ty tz`` (world to camera, metres) for each
    photograph found; the CSV has a row for each photograph: status, camera centre in the map's
    frame, latitude, longitude, altitude, sigma and the reason of a failure.

    Args:
        place: the map.
        photographs: folder.
        localizer: method.
        out: text file of the poses.
        camera: of the photographs; None takes the map's own where it has one of their size.
        priors: CSV of positions and attitudes; None takes positions from EXIF, where there are any.
        gps_sigma_m: standard deviation of EXIF positions, per axis.
        cache: folder for the method's per-map state.

    Raises:
        InputError: no photograph, a damaged one, no camera for one, or ``out`` cannot be written.
    """
    names = _photographs(photographs)
    cameras = {name: camera or _camera(photographs / name, place) for name in names}
    known = read_priors(priors) if priors is not None else None
    with kept_or_scratch(cache, out.parent) as kept:
        localizer.prepare(place.sparse_map, place.images, kept)
    located = []
    with progress_bar(f"localize with {localizer.name}", len(names)) as advance:
        for name in names:
            path = photographs / name
            prior = _exif_prior(path, place, gps_sigma_m) if known is None else known.get(name)
            query = Query(name, read_rgb(path, cameras[name]), cameras[name], prior)
            estimate = localizer.localize(query)
            located.append(Located(name, estimate, _geodetic(estimate, place)))
            advance(len(located))
    write_text(out, _pose_lines(located))
    write_text(out.with_suffix(".csv"), _table(located))
    return located


def _photographs(folder: Path) -> list[str]:
    if not folder.is_dir():
        raise InputError(f"folder of photographs {folder} does not exist")
    names = sorted(p.name for p in folder.iterdir() if p.suffix.lower() in _PHOTOGRAPHS)
    if not names:
        raise InputError(f"{folder} holds no photograph ({', '.join(_PHOTOGRAPHS)})")
    return names


def _camera(path: Path, place: Place) -> Camera:
    """The map's camera of the photograph's size."""
    height, width = read_rgb(path).shape[:2]
    images = place.sparse_map.images.values()
    fitting = {i.camera for i in images if (i.camera.width, i.camera.height) == (width, height)}
    if len(fitting) != 1:
        raise InputError(
            f"{path} is {width} x {height} pixels and the map has {len(fitting)} cameras of that "
            "size: give its calibration with --camera 'MODEL width height params...'"
        )
    return fitting.pop()


def _exif_prior(path: Path, place: Place, sigma_m: float) -> Prior | None:
    position = read_exif(path).position
    if position is None or place.origin is None:
        return None
    return Prior(enu_from_geodetic(position, place.origin), np.full(3, sigma_m))


def _geodetic(estimate: Estimate, place: Place) -> Geodetic | None:
    if estimate.cam_from_world is None or place.origin is None:
        return None
    return geodetic_from_enu(_centre(estimate), place.origin)


def _centre(estimate: Estimate) -> NDArray[np.float64]:
    assert estimate.cam_from_world is not None
    return np.asarray(estimate.cam_from_world.centre().numpy())


def _pose_lines(located: Sequence[Located]) -> str:
    lines = ["# name qw qx qy qz tx ty tz  (world to camera, metres)"]
    for item in located:
        pose = item.estimate.cam_from_world
        if item.found and pose is not None:
            lines.append(pose_line(item.name, pose, 9))
    return "\n".join(lines) + "\n"


def _table(located: Sequence[Located]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(_rows(located))
    return text.getvalue()


def _rows(located: Sequence[Located]) -> Iterator[Mapping[str, Any]]:
    for item in located:
        estimate, row = item.estimate, {"name": item.name, "status": item.estimate.status.value}
        row |= {"inliers": str(estimate.inliers), "reason": estimate.reason}
        if estimate.cam_from_world is not None:
            row |= {k: f"{x:.4f}" for k, x in zip("enu", _centre(estimate), strict=True)}
            sigma = estimate.sigma_position()
            row["sigma_m"] = "" if sigma is None else f"{sigma:.4f}"
        if item.place is not None:
            row |= {
                "latitude": f"{item.place.latitude:.8f}",
                "longitude": f"{item.place.longitude:.8f}",
                "altitude": f"{item.place.altitude:.3f}",
            }
        yield row


def _origin(path: Path) -> Geodetic | None:
    """The flight's ``origin.json``, when it has one."""
    file = path / "origin.json"
    if not file.is_file():
        return None
    try:
        values = parse_json(read_text(file, "origin"))
        origin = Geodetic(float(values["lat"]), float(values["lon"]), float(values["alt"]))
    except (ValueError, KeyError, TypeError, OverflowError):
        origin = Geodetic(math.nan, math.nan, math.nan)
    if not all(map(math.isfinite, origin)):
        raise InputError(f"{file} must hold numbers lat, lon and alt")
    return origin
