"""The command ``landmarks``: detect the objects of a scene's map and store them in the scene."""

from __future__ import annotations

import csv
import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np

from objconnect.learning.checkpoint import shipped_path
from objconnect.localization.cache.map_cache import open_cache
from objconnect.localization.featuremetric.maps import MapExtractor
from objconnect.network.landmarks import Landmarks, Tracks, merge
from objconnect.network.localizer import SHIPPED, ObjConnectConfig
from objconnect.network.network import read_network
from objconnect.network.object_map import ObjectFinder
from objconnect.scene.bundle.scene import Scene, finish_scene
from objconnect.scene.errors import HDF5_DAMAGE, InputError
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.device import AUTO, torch_device
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.hdf5 import array
from objconnect.scene.storage.hdf5_writing import hdf5_file
from objconnect.scene.storage.leftovers import remove_partial
from objconnect.scene.storage.locks import write_lock
from objconnect.scene.storage.names import quote_cell
from objconnect.scene.storage.outputs import OutputFile, check_outputs

LANDMARKS: Final = "landmarks.h5"
"""Name of the file of a scene with the landmarks (the objects) of its map."""

_HEAD: Final = "landmark,e,n,u,side_m,above_ground_m,probability,photographs,first_photograph"


@dataclass(frozen=True)
class LandmarksReport:
    """The landmarks of a scene's map, the number of their observations in photographs, and the
    files that were written."""

    landmarks: Landmarks
    observations: int
    files: tuple[Path, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the report as a dictionary for JSON."""
        return {
            "landmarks": len(self.landmarks),
            "observations": self.observations,
            "files": [str(file) for file in self.files],
        }

    def text(self) -> str:
        """Return the report as text."""
        sides = self.landmarks.sides
        width = f", {np.median(sides):.1f} m wide in the median" if len(sides) else ""
        summary = f"{len(sides)} objects{width}, with {self.observations} observations"
        return "\n".join([summary, *map(str, self.files)])


def find_landmarks(
    path: Path, weights: Path | None = None, out: Path | None = None, device: str = AUTO
) -> LandmarksReport:
    """Detect the objects of a scene's map and store them in the scene.

    Landmarks of an earlier call are replaced. The map does not change.

    Args:
        path: finished scene with a map.
        weights: file of an object-connect network with a detector; None for the shipped one.
        out: CSV table of the landmarks to write in addition; None for no table.
        device: device of the network, as in ``objconnect.scene.runtime.device.Device``.

    Raises:
        InputError: the scene is not finished or has no map, the weights have no detector, a
            photograph is missing or broken, ``out`` cannot be written, or the device does not
            exist.
    """
    network_device, scene = torch_device(device), Scene.open(path)
    outputs: list[OutputFile | Path] = [path / LANDMARKS]
    outputs += [] if out is None else [OutputFile(out, _HEAD.encode())]
    check_outputs(outputs, [path, *([] if weights is None else [weights])])
    network = read_network(weights or shipped_path(SHIPPED))[0].to(network_device)
    if network.detector is None:
        raise InputError(
            f"{weights or 'the shipped network'} has no detector of objects: train one with "
            "'train objects'"
        )
    sparse_map = scene.sparse_map()
    config = ObjConnectConfig()
    extract = MapExtractor(network, config.longest, config.precision)
    finder = ObjectFinder(extract, network.detector)
    with open_cache(sparse_map, scene.images_root, None) as map_cache:
        landmarks, tracks = merge(finder.views(map_cache))
    with write_lock(path):
        remove_partial(path)
        _write(path / LANDMARKS, landmarks, tracks, sparse_map)
        finish_scene(path, scene.manifest)
    if out is not None:
        write_text(out, _table(landmarks, tracks))
    files = (path / LANDMARKS, *([] if out is None else [out]))
    return LandmarksReport(landmarks, len(tracks.landmark), files)


def read_landmarks(scene: Scene, sparse_map: SparseMap) -> tuple[Landmarks, Tracks] | None:
    """Return the landmarks stored in a scene, and their observations.

    The result is None if none are stored, or if they belong to another version of the map.

    Raises:
        InputError: the file of landmarks is damaged.
    """
    path = scene.path / LANDMARKS
    if not os.path.lexists(path):
        return None
    try:
        with h5py.File(path) as file:
            if file.attrs.get("map") != sparse_map.sha256:
                return None
            landmarks = Landmarks.of({name: array(file, name) for name in Landmarks.ARRAYS})
            landmark, name, xy = (array(file, f"tracks/{part}") for part in Tracks._fields)
    except HDF5_DAMAGE as error:
        raise InputError(f"{path} is damaged ({error}): run 'objconnect landmarks' again") from None
    names = [os.fsdecode(each) for each in name.tolist()]
    return landmarks, Tracks(landmark.astype(np.int64), names, xy.astype(np.float64))


def _write(path: Path, landmarks: Landmarks, tracks: Tracks, sparse_map: SparseMap) -> None:
    with hdf5_file(path) as file:
        file.attrs["map"] = sparse_map.sha256
        for name, values in landmarks.arrays().items():
            file[name] = values
        file["tracks/landmark"] = tracks.landmark.astype(np.uint32)
        file["tracks/name"] = np.array([os.fsencode(name) for name in tracks.name], "S")
        file["tracks/xy"] = tracks.xy.astype(np.float32)


def _table(landmarks: Landmarks, tracks: Tracks) -> str:
    """Return the landmarks as CSV, each with the first photograph that shows it."""
    first = dict(zip(reversed(tracks.landmark.tolist()), reversed(tracks.name), strict=True))
    text = io.StringIO()
    text.write(f"{_HEAD}\n")
    rows = csv.writer(text, lineterminator="\n")
    for row, (e, n, u) in enumerate(landmarks.xyz.tolist()):
        numbers = (e, n, u, float(landmarks.sides[row]), float(landmarks.rises[row]))
        rows.writerow(
            [
                row,
                *(f"{number:.2f}" for number in numbers),
                f"{landmarks.scores[row]:.3f}",
                int(landmarks.views[row]),
                quote_cell(first[row]),
            ]
        )
    return text.getvalue()
