"""The folder that a container reads: a map, photographs, and each query's starting information.

It holds no reference pose. Photographs of queries are written again as PNG files of the same
pixels, because the metadata of their files may hold positions.
"""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmark.datasets.dataset import Task
from benchmark.evaluation.starts import Start
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Prior
from objconnect.scene.maps.colmap_files import MODEL_FILES
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.files import is_safe_path
from objconnect.scene.storage.names import quote_name

MAP: Final = "map"
"""Folder of the map, a COLMAP model."""
PHOTOGRAPHS: Final = "images"
"""Folder of the map's photographs, by their names in the model."""
QUERIES: Final = "queries"
"""Folder of the photographs of the queries, ``NAME.png``."""
CAMERAS: Final = "queries.txt"
"""Lines ``NAME MODEL WIDTH HEIGHT PARAMS...``, in the format of hloc."""
PAIRS: Final = "pairs.txt"
"""Lines ``QUERY REFERENCE``, if the starting information names reference images."""
PRIORS: Final = "priors.json"
"""The prior of each query by its name, if methods get priors; see ``_describe_prior``."""


def write_data(task: Task, start: Start, folder: Path) -> None:
    """Write the map and the queries of a data set into an empty folder.

    Args:
        task: data set.
        start: starting information of each query besides its photograph.
        folder: folder to fill.

    Raises:
        InputError: the photograph of a query is missing or damaged, or the folder cannot be
            written.
    """
    (folder / MAP).mkdir()
    for name in MODEL_FILES:
        if (task.model / name).is_file():
            _link_or_copy(task.model / name, folder / MAP / name)
    sparse_map = task.load_map()
    for name in sparse_map.names:
        # A method that needs a missing photograph reports it.
        if (task.images / name).is_file():
            _link_or_copy(task.images / name, folder / PHOTOGRAPHS / name)
    load = start.loader(task, sparse_map)
    cameras, pairs = [], []
    priors: dict[str, Any] = {}
    with progress_bar(f"{task.name} photographs", len(task.queries)) as advance:
        for number, query in enumerate(task.queries, 1):
            loaded = load(query)
            _write_picture(folder / QUERIES, query.name, loaded.image)
            cameras.append(f"{quote_name(query.name)} {query.camera}")
            if loaded.prior is not None:
                priors[query.name] = _describe_prior(loaded.prior)
            for reference in loaded.references or ():
                pairs.append(f"{quote_name(query.name)} {quote_name(reference)}")
            advance(number)
    write_text(folder / CAMERAS, "".join(f"{line}\n" for line in cameras))
    if pairs:
        write_text(folder / PAIRS, "".join(f"{line}\n" for line in pairs))
    if priors:
        write_text(folder / PRIORS, json.dumps(priors, indent=1) + "\n")


def _link_or_copy(source: Path, target: Path) -> None:
    """Link a file, or copy it where the file system has no links."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source.resolve(), target)
    except OSError:
        shutil.copyfile(source, target)


def _write_picture(folder: Path, name: str, rgb: NDArray[np.uint8]) -> None:
    if not is_safe_path(name):
        raise InputError(f"query {name!r} does not lie in the folder of its data set")
    path = folder / f"{name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(rgb).save(path, "PNG", compress_level=1)


def _describe_prior(prior: Prior) -> dict[str, Any]:
    """Return a prior as JSON; unknown values are null.

    ``position`` and ``position_sigma`` are metres in the map's frame, ``cam_from_world`` is a
    quaternion w x y z, and the other sigmas are degrees.
    """
    rotation = prior.cam_from_world_rotation
    attitude = None
    if rotation is not None:
        import torch

        attitude = Pose(torch.from_numpy(rotation), torch.zeros(3, dtype=torch.float64))
    sigma = prior.position_sigma
    return {
        "position": prior.position.tolist() if prior.has_position else None,
        "position_sigma": None if sigma is None else [_finite_or_none(x) for x in sigma.tolist()],
        "cam_from_world": None if attitude is None else attitude.quaternion().tolist(),
        "attitude_sigma_deg": _finite_or_none(prior.attitude_sigma_deg),
        "has_heading": prior.has_heading,
    }


def _finite_or_none(number: float | None) -> float | None:
    return number if number is not None and np.isfinite(number) else None
