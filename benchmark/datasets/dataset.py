"""What localizers are scored on, whatever form it has on disk."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from benchmark.datasets.identity import sha256_of_parts
from scene.errors import InputError
from scene.geometry.camera import Camera
from scene.geometry.pose import Pose
from scene.localizer import Prior, Query
from scene.maps.sparse_map import SparseMap
from scene.runtime.printed import printed
from scene.storage.images import read_rgb
from scene.storage.names import is_utf8


@dataclass(frozen=True)
class BenchmarkQuery:
    """One query and, apart from it, the truth about it.

    Attributes:
        name: unique within the data set.
        condition: season and light, or whatever the data set is divided by.
        group: the flight or drive it belongs to: errors within one go together.
        camera: calibrated.
        image: file of the photograph.
        prior: starting information, or None where the data set has none for this query.
        reference: ``cam_from_world`` that an estimate is scored against; no localizer sees it.
    """

    name: str
    condition: str
    group: str
    camera: Camera
    image: Path
    prior: Prior | None
    reference: Pose

    def load(self, prior: Prior | None = None, references: tuple[str, ...] | None = None) -> Query:
        """Read the photograph; the method is told no more than the arguments.

        Raises:
            InputError: it is missing, damaged, or not of the camera's size.
        """
        image = read_rgb(self.image, self.camera)
        return Query(self.name, image, self.camera, prior, references)


@dataclass(frozen=True)
class Dataset:
    """A map, and queries with reference poses.

    Attributes:
        name: folder of its results.
        track: what it can show: "uav-sim" (changed season and light), "flight" (photographs) or
            "cmu" (a car's photographs through a year; "cmu-sim" when they are simulated).
        parts: digests of all it is made of, by what a person calls it (``identity``).
        map_conditions: conditions the map's photographs were taken under.
        model: folder of the map's files.
        load_map: reads the map.
        images: folder that the map's image names are relative to.
        queries: in the order of the data set's own list; never empty.
    """

    name: str
    track: str
    parts: Mapping[str, str]
    map_conditions: tuple[str, ...]
    model: Path
    load_map: Callable[[], SparseMap]
    images: Path
    queries: tuple[BenchmarkQuery, ...]

    def __post_init__(self) -> None:
        """InputError: a name that no results file can hold."""
        for name in (self.name, *(query.name for query in self.queries)):
            if not is_utf8(name):
                raise InputError(f"{printed(name)!r}: this name is not UTF-8: rename it")

    @cached_property
    def sha256(self) -> str:
        """Digest of all parts: with another byte in one of them it is another data set."""
        return sha256_of_parts(self.parts)


def open_datasets(path: Path) -> list[Dataset]:
    """Open the data sets of a folder.

    A scene (it has ``scene.json``) is one data set. A flight is one, or two with its hard split,
    whose name ends in ``-sparse``; a path with that ending opens the hard split alone. Extended CMU
    Seasons is one for every slice with public query poses; a slice's folder opens it alone.

    Raises:
        InputError: no such folder, none of these, or anything wrong inside it.
    """
    # Each kind is built from the types above, so the kinds cannot be imported before them.
    from benchmark.datasets.cmu import is_cmu, open_cmu
    from benchmark.datasets.flight import SPARSE_SUFFIX, is_flight, open_flight
    from benchmark.datasets.simulated import is_scene, open_scene

    if path.is_dir():
        if is_scene(path):
            return [open_scene(path)]
        if is_cmu(path):
            return open_cmu(path)
        if is_flight(path):
            return open_flight(path)
        raise InputError(
            f"{path} is not a data set: it has neither scene.json (a finished scene), nor "
            "queries.txt, reference_poses.txt and sparse/map (a flight), nor intrinsics.txt and "
            "slice folders (Extended CMU Seasons)"
        )
    whole = path.with_name(path.name.removesuffix(SPARSE_SUFFIX)) if path.name else path
    if whole != path and is_flight(whole):
        return [d for d in open_flight(whole, sparse=True) if d.name == path.name]
    raise InputError(f"data set {path} does not exist")
