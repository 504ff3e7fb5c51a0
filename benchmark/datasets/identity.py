"""Digests that identify a data set: of its files, and of the poses and priors of its queries.

The digests of files cover the photographs of the queries and of the map, and the files of the map.
They are computed from the bytes on disk, not taken from a manifest. Names are relative, so that a
copy in another folder is the same data set.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

from benchmark.datasets.dataset import BenchmarkQuery, Dataset, Task, TaskQuery, digest_of_parts
from objconnect.scene.errors import InputError
from objconnect.scene.maps.colmap_files import MODEL_FILES
from objconnect.scene.storage.digests import digests, digests_in, sha256
from objconnect.scene.storage.jpeg import read_bare_jpeg
from objconnect.scene.storage.names import name_some

# Digest of a map photograph that does not exist. A method that needs the photograph reports it.
_MISSING: Final = "missing"


def parts_of(
    model: Path, images: Path, map_names: Iterable[str], queries: Sequence[TaskQuery]
) -> dict[str, str]:
    """Return digests of everything a data set is made of, by descriptive names.

    Args:
        model: folder of the map's files.
        images: folder that ``map_names`` are relative to.
        map_names: names of the map's photographs.
        queries: in the order of the data set.

    Raises:
        InputError: a photograph of a query or a file of the map is missing or cannot be read.
    """
    parts = {f"map file {name}": digest for name, digest in digests_in(model, MODEL_FILES).items()}
    photographs = digests_in(images, sorted(map_names), _MISSING)
    parts |= {f"map photograph {name}": digest for name, digest in photographs.items()}
    query_digests = digests(query.image for query in queries)
    for query, photograph in zip(queries, query_digests, strict=True):
        parts |= _parts_of_query(query, photograph)
    return parts


def sealed_sha256(dataset: Dataset) -> str:
    """Return the digest of the public half of a data set whose query poses are withheld.

    It covers no reference pose, and the photographs of the queries without their metadata.

    Raises:
        InputError: a photograph of a query is not a JPEG file, or cannot be read.
    """
    parts = {part: digest for part, digest in dataset.parts.items() if part.startswith("map ")}
    for query in dataset.queries:
        photograph = sha256(read_bare_jpeg(query.image))
        parts |= _parts_of_query(query.without_reference(), photograph)
    return digest_of_parts(parts)


def _parts_of_query(query: TaskQuery, photograph: str) -> dict[str, str]:
    values = "prior or reference pose" if isinstance(query, BenchmarkQuery) else "or prior"
    return {
        f"query photograph {query.name}": photograph,
        f"condition, camera, {values} of {query.name}": digest_values(query),
    }


def describe_changes(before: Mapping[str, str], after: Mapping[str, str]) -> str:
    """Describe in words which parts differ; the text is empty if none does."""
    parts = dict.fromkeys([*before, *after])
    differing = [part for part in parts if before.get(part) != after.get(part)]
    if not differing and list(before) != list(after):
        return "the order of the queries"
    return name_some(differing)


def require_unchanged(dataset: Task, map_names: Iterable[str]) -> None:
    """Refuse a data set that has changed since it was opened.

    Args:
        dataset: as it was opened.
        map_names: names of the map's photographs.

    Raises:
        InputError: the data set has changed, or ``parts_of`` raises it.
    """
    current = parts_of(dataset.model, dataset.images, map_names, dataset.queries)
    if changed := describe_changes(dataset.parts, current):
        raise InputError(
            f"the data set {dataset.name} was changed during the run: {changed}; run again"
        )


def digest_values(query: TaskQuery) -> str:
    """Return the digest of a query's condition, camera, prior and, if it is known, reference pose.

    Numbers are rounded to nine decimals, because their last bits depend on the processor.
    """
    values: list[list[float] | None] = []
    if isinstance(query, BenchmarkQuery):
        values += [
            query.reference.rotation.flatten().tolist(),
            query.reference.translation.tolist(),
        ]
    prior = query.prior
    if prior is not None:
        sigma, attitude = prior.position_sigma, prior.cam_from_world_rotation
        values += [
            prior.position.tolist(),
            None if sigma is None else sigma.tolist(),
            None if attitude is None else attitude.ravel().tolist(),
            None if prior.attitude_sigma_deg is None else [prior.attitude_sigma_deg],
        ]
        if prior.heading_sigma_deg is not None:
            values.append([prior.heading_sigma_deg])
    numbers = [None if row is None else [f"{x + 0.0:.9f}" for x in row] for row in values]
    words = [query.name, query.condition, str(query.camera), numbers]
    return sha256(json.dumps(words))
