"""Digests that identify a data set: of its files, and of the poses and priors of its queries.

The digests cover the photographs of the queries and of the map, and the files of the map. All are
computed from the bytes on disk, not taken from a manifest. Names are relative, so that a copy in
another folder is the same data set.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

from benchmark.datasets.dataset import BenchmarkQuery, Dataset
from objconnect.scene.errors import InputError
from objconnect.scene.maps.colmap_files import MODEL_FILES
from objconnect.scene.storage.digests import digests, digests_in, sha256

# Digest of a map photograph that does not exist: methods that need it report it themselves.
_MISSING: Final = "missing"
# Number of parts that a message names when more differ.
_NAMED: Final = 3


def parts_of(
    model: Path, images: Path, map_names: Iterable[str], queries: Sequence[BenchmarkQuery]
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
    parts = {f"map file {name}": of for name, of in digests_in(model, MODEL_FILES).items()}
    photographs = digests_in(images, sorted(map_names), _MISSING)
    parts |= {f"map photograph {name}": of for name, of in photographs.items()}
    query_digests = digests(query.image for query in queries)
    for query, photograph in zip(queries, query_digests, strict=True):
        parts[f"query photograph {query.name}"] = photograph
        parts[f"condition, camera, prior or reference pose of {query.name}"] = _digest_values(query)
    return parts


def changes(before: Mapping[str, str], after: Mapping[str, str]) -> str:
    """Describe in words which parts differ; the text is empty when none does."""
    every = dict.fromkeys([*before, *after])
    differing = [part for part in every if before.get(part) != after.get(part)]
    if not differing and list(before) != list(after):
        return "the order of the queries"
    named = ", ".join(differing[:_NAMED])
    more = len(differing) - _NAMED
    return f"{named} and {more} more" if more > 0 else named


def require_unchanged(dataset: Dataset, map_names: Iterable[str]) -> None:
    """Refuse a data set that has changed since it was opened.

    Args:
        dataset: as it was opened.
        map_names: names of the map's photographs.

    Raises:
        InputError: the data set has changed, or ``parts_of`` raises it.
    """
    now = parts_of(dataset.model, dataset.images, map_names, dataset.queries)
    if changed := changes(dataset.parts, now):
        raise InputError(f"the data set {dataset.name} was changed during the run: {changed}")


def _digest_values(query: BenchmarkQuery) -> str:
    """Return the digest of a query's condition, camera, prior and reference pose.

    Numbers are rounded to nine decimals, because their last bits depend on the processor.
    """
    reference, prior = query.reference, query.prior
    values: list[list[float] | None] = [
        reference.rotation.flatten().tolist(),
        reference.translation.tolist(),
    ]
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
