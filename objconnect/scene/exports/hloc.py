"""Export to hloc: the list of queries, pairs of photographs to match, and the map's features.

``queries_with_intrinsics.txt`` has lines "name MODEL width height params...". ``pairs-map.txt``
lists the pairs of covisible frames of the map. ``pairs-query.txt`` pairs each query with the map
frames that see the largest shares of its surface; this is perfect retrieval, an upper bound.

``features.h5`` and ``matches.h5`` have the layout of hloc's ``extract_features`` and
``match_features``. A photograph is a group with ``keypoints`` (N, 2), whose origin is the centre of
the top left pixel, ``descriptors`` (D, N), ``scores``, ``scales`` and ``image_size``. A pair is a
group ``NAME0/NAME1``, with "-" for "/" in the names. Its ``matches0`` is, for each keypoint of the
first photograph, the index of the matching keypoint of the second, -1 for none; its
``matching_scores0`` is 1 for a match, else 0. ``pairs.txt`` lists these pairs.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from objconnect.scene.bundle.covisibility import MIN_SHARED_SURFACE
from objconnect.scene.bundle.frames import Frames
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.exports.matches import iterate_matches, map_pairs, read_map_features
from objconnect.scene.maps.features import unit_descriptors
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.hdf5_writing import open_hdf5
from objconnect.scene.storage.names import quote_name

PAIRS_PER_QUERY: Final = 20
"""Largest number of map photographs that a query is paired with."""


def write(scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path) -> None:
    """Write the query list and both pair lists; see ``formats.Writer``.

    Raises:
        InputError: the sessions have no query, or the scene has no covisibility.
    """
    cameras = {
        name: camera
        for frames in sessions.values()
        for name, camera in zip(frames.names, frames.cameras, strict=True)
    }
    map_names = set(scene.splits.map)
    queries = [name for name in cameras if name not in map_names]
    if not queries:
        raise InputError("these sessions have no query: name a session of queries")
    references = scene.splits.map
    covisibility = scene.covisibility.select([*references, *queries])
    query_pairs = []
    for k, query in enumerate(queries, len(references)):
        shares = covisibility.overlap[k, : len(references)]
        best = np.argsort(-shares, kind="stable")[:PAIRS_PER_QUERY]
        covisible = [references[j] for j in best if shares[j] >= MIN_SHARED_SURFACE]
        query_pairs += [_pair(query, name) for name in covisible]
    lists = {
        "queries_with_intrinsics.txt": [
            f"{quote_name(name)} {cameras[name]}\n" for name in queries
        ],
        "pairs-map.txt": [_pair(a, b) for a, b in map_pairs(scene)],
        "pairs-query.txt": query_pairs,
    }
    for file, lines in lists.items():
        (folder / file).write_text("".join(lines), "utf-8")


def write_features(scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path) -> None:
    """Write the features and matches of the map, and its pairs; see ``formats.Writer``.

    Raises:
        InputError: the scene has no map or no covisibility, or its features are missing or are not
            the map's.
    """
    sparse_map, features = read_map_features(scene)
    count = len(sparse_map.names)
    with open_hdf5(folder / "features.h5") as file, progress_bar("features", count) as advance:
        for done, name in enumerate(sparse_map.names, 1):
            item, camera = features[name], sparse_map.images[name].camera
            group = file.create_group(name)
            group["keypoints"] = item.xy - np.float32(0.5)
            group["descriptors"] = unit_descriptors(item.descriptors).numpy().T
            group["scores"] = np.ones(len(item.xy), np.float32)
            group["scales"] = item.scale
            group["image_size"] = np.array([camera.width, camera.height])
            advance(done)
    lines = []
    with open_hdf5(folder / "matches.h5") as file:
        for a, b, matches in iterate_matches(scene, sparse_map):
            matches0 = np.full(len(sparse_map.images[a].xy), -1, np.int32)
            matches0[matches[:, 0]] = matches[:, 1]
            group = file.create_group("/".join(name.replace("/", "-") for name in (a, b)))
            group["matches0"] = matches0
            group["matching_scores0"] = (matches0 >= 0).astype(np.float32)
            lines.append(_pair(a, b))
    (folder / "pairs.txt").write_text("".join(lines), "utf-8")


def _pair(a: str, b: str) -> str:
    return f"{quote_name(a)} {quote_name(b)}\n"
