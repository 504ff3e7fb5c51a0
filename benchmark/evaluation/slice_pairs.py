"""Pair lists of hloc for slices of Extended CMU Seasons: reading and validation."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from benchmark.datasets.cmu import Slice, path_of_test_list, read_test_list
from objconnect.scene.errors import InputError
from objconnect.scene.flights.textfiles import read_pairs
from objconnect.scene.storage.names import name_some

Pairs = Mapping[str, tuple[str, ...]]
"""Names of map photographs by the name of a query image."""


def read_slice_pairs(path: Path, map_names: Mapping[Slice, Collection[str]]) -> Pairs:
    """Read the pairs of the query images of some slices.

    Every image in a slice's list of test images needs a pair; without such a list, every query
    image needs one. The lists of hloc leave out the other query images.

    Args:
        path: pair list with lines ``query reference``.
        map_names: names of the map photographs of each slice.

    Raises:
        InputError: the file cannot be read, or ``describe_faults`` finds a fault.
    """
    pairs = read_pairs(path)
    for fault in describe_faults(path, pairs, map_names):
        raise InputError(fault)
    return pairs


def describe_faults(
    path: Path, pairs: Pairs, map_names: Mapping[Slice, Collection[str]]
) -> Iterator[str]:
    """Yield a sentence about unknown query images, missing lines and unknown map photographs.

    Args:
        path: pair list, for messages.
        pairs: its pairs.
        map_names: names of the map photographs of each slice.
    """
    queries = {name for each in map_names for name in each.queries}
    if unknown := [name for name in pairs if name not in queries]:
        folders = ", ".join(each.folder.name for each in map_names)
        yield (
            f"{path}: {name_some(unknown)}: not among the query images of {folders}; remove the "
            "lines, or submit their slices too"
        )
    for each, names in map_names.items():
        needed = _list_images_to_pair(each)
        if missing := [name for name in needed if name not in pairs]:
            yield (
                f"{path} has no line for {len(missing)} of {len(needed)} test images of "
                f"{each.folder.name} ({name_some(missing)}): add their pairs"
            )
        strange = {r for q in each.queries for r in pairs.get(q, ()) if r not in names}
        if strange:
            yield (
                f"{path}: {name_some(sorted(strange))}: not among the map photographs of "
                f"{each.folder.name}; remove the lines"
            )


def _list_images_to_pair(each: Slice) -> list[str]:
    """Return the query images of a slice that need a pair, sorted."""
    if not path_of_test_list(each.folder).exists():
        return list(each.queries)
    return sorted(read_test_list(each.folder).intersection(each.queries))
