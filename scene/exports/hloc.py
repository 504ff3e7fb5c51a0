"""Export to hloc: the list of queries, and pairs of photographs to match.

``queries_with_intrinsics.txt`` has lines "name MODEL width height params...". ``pairs-map.txt``
lists the covisible frames of the map, and ``pairs-query.txt`` gives each query the map frames that
see most of it: retrieval without errors, which is an upper bound.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from scene.bundle.covisibility import COVISIBLE
from scene.bundle.frames import Frames
from scene.bundle.scene import Scene
from scene.errors import InputError
from scene.storage.names import quote_name

PAIRS_PER_QUERY: Final = 20
"""Number of map frames that each query is paired with at most."""


def write(scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path) -> None:
    """Write the three lists; see ``formats.Writer``.

    Raises:
        InputError: the sessions have no query, or the scene has no covisibility.
    """
    cameras = {
        name: camera
        for frames in sessions.values()
        for name, camera in zip(frames.names, frames.cameras, strict=True)
    }
    mapped = set(scene.splits.map)
    queries = [name for name in cameras if name not in mapped]
    if not queries:
        raise InputError("these sessions have no query: name a session of queries")
    references = scene.splits.map
    among = scene.covisibility.of([*references, *queries])
    mutual = among.mutual[: len(references), : len(references)]
    map_pairs = [
        f"{quote_name(references[i])} {quote_name(references[j])}\n"
        for i, j in np.argwhere(np.triu(mutual) >= COVISIBLE)
    ]
    query_pairs = []
    for k, query in enumerate(queries, len(references)):
        shares = among.overlap[k, : len(references)]
        best = np.argsort(-shares, kind="stable")[:PAIRS_PER_QUERY]
        seen = [references[j] for j in best if shares[j] >= COVISIBLE]
        query_pairs += [f"{quote_name(query)} {quote_name(name)}\n" for name in seen]
    lists = {
        "queries_with_intrinsics.txt": [
            f"{quote_name(name)} {cameras[name]}\n" for name in queries
        ],
        "pairs-map.txt": map_pairs,
        "pairs-query.txt": query_pairs,
    }
    for file, lines in lists.items():
        (folder / file).write_text("".join(lines), "utf-8")
