"""Starting information: what a method gets with a query besides its image.

Results record it, and methods are compared only with the same starting information.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.sift import SiftConfig
from benchmark.datasets.dataset import BenchmarkQuery, Dataset, Task, TaskQuery
from objconnect.localization.cache.map_cache import open_cache
from objconnect.localization.matching.features import map_features
from objconnect.localization.matching.retrieval import LazyDescriptors, VladIndex
from objconnect.localization.matching.sift import Sift
from objconnect.scene.errors import InputError
from objconnect.scene.flights.textfiles import read_pairs
from objconnect.scene.geometry.geodesy import FARTHEST_M
from objconnect.scene.geometry.pose import Pose, so3_exp
from objconnect.scene.localizer import Prior, Query
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.digests import sha256
from objconnect.scene.storage.files import read_text
from objconnect.scene.storage.images import read_rgb

_ERROR: Final = re.compile(r"error=([0-9.]+)m,([0-9.]+)deg")
_GRAVITY: Final = re.compile(r"gravity(?:=([0-9.]+)deg)?")
_GPS: Final = re.compile(r"gps=([0-9.]+)m")
_RETRIEVAL: Final = re.compile(r"retrieval(?:=([1-9][0-9]{0,8}))?")
_DEFAULT_TOP: Final = 10
# Tilt of ``gravity`` without a size: the usual error of a gimbal.
_DEFAULT_TILT_DEG: Final = 3.0
# No rotation has a larger angle.
_MAX_DEG: Final = 180.0

LoadQuery = Callable[[TaskQuery], Query]
"""Reads the photograph of a query and adds the starting information to it."""


@dataclass(frozen=True)
class Start:
    """A kind of starting information.

    Attributes:
        name: name in the results; different starts have different names.
        kind: "prior" gives the prior pose of the data set, "none" gives nothing, "retrieval" gives
            the ``top`` map photographs that look most like the query, "pairs" gives map photographs
            from a file, and "error" gives the reference pose, shifted by exactly ``metres`` and
            rotated by exactly ``degrees`` in random directions. "gravity" gives the attitude,
            tilted by exactly ``degrees`` and turned to a random heading, and no position; "gps"
            gives the position alone, wrong by exactly ``metres``.
        top: number of map photographs of "retrieval".
        metres: position error of "error" and "gps".
        degrees: attitude error of "error", and tilt error of "gravity".
        pairs: names of map photographs by the name of the query, for "pairs".
    """

    name: str
    kind: Literal["prior", "none", "retrieval", "pairs", "error", "gravity", "gps"]
    top: int = 0
    metres: float = 0.0
    degrees: float = 0.0
    pairs: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def loader(self, dataset: Task, sparse_map: SparseMap, cache: Path | None = None) -> LoadQuery:
        """Return the function that loads a query with this starting information.

        Args:
            dataset: data set of the queries.
            sparse_map: its map.
            cache: folder for the features that retrieval needs; None keeps none.

        Raises:
            InputError: a query has no pair, a pair names a photograph that the map lacks, or the
                start is made from reference poses and these are withheld.
        """
        self.require_references(dataset)
        if self.kind == "prior":
            return lambda query: query.load(query.prior)
        if self.kind == "error":
            return lambda query: query.load(
                move_prior(_reference(query), query.name, self.metres, self.degrees)
            )
        if self.kind == "gravity":
            return lambda query: query.load(
                gravity_prior(_reference(query), query.name, self.degrees)
            )
        if self.kind == "gps":
            return lambda query: query.load(
                position_prior(_reference(query), query.name, self.metres)
            )
        if self.kind == "retrieval":
            retrieve = _create_retriever(dataset, sparse_map, self.top, cache)
            return lambda query: query.load(references=retrieve(query))
        if self.kind == "pairs":
            self._check_pairs(dataset, sparse_map)
            return lambda query: query.load(references=self.pairs[query.name])
        return TaskQuery.load

    def require_references(self, dataset: Task) -> None:
        """Refuse a start that is made from reference poses where these are withheld.

        Raises:
            InputError: the data set has no reference poses, and the start needs them.
        """
        if self.kind in ("error", "gravity", "gps") and not isinstance(dataset, Dataset):
            raise InputError(
                f"start {self.name} is made from the reference poses, which are withheld in "
                f"{dataset.name}: use the start none, prior, retrieval or pairs"
            )

    def _check_pairs(self, dataset: Task, sparse_map: SparseMap) -> None:
        for query in dataset.queries:
            if query.name not in self.pairs:
                raise InputError(
                    f"the pair list has no photograph of the map for {query.name}: add a line"
                )
            for name in self.pairs[query.name]:
                if name not in sparse_map.images:
                    raise InputError(
                        f"the pair list names {name} for {query.name}: the map has no such image; "
                        "remove the line"
                    )


PRIOR: Final = Start("prior", "prior")
NONE: Final = Start("none", "none")


def parse_start(text: str) -> Start:
    """Read a start: ``prior``, ``none``, ``retrieval[=K]``, ``pairs=FILE``, ``error=3m,5deg``,
    ``gravity[=3deg]`` or ``gps=50m``.

    A pair list is hloc's: lines "query reference".

    Raises:
        InputError: the text has another form, or the pair list cannot be read.
    """
    if text in ("prior", "none"):
        return PRIOR if text == "prior" else NONE
    if match := _RETRIEVAL.fullmatch(text):
        top = int(match.group(1) or _DEFAULT_TOP)
        return Start(f"retrieval={top}", "retrieval", top=top)
    if match := _ERROR.fullmatch(text):
        metres, degrees = _parse_size(text, match.group(1)), _parse_size(text, match.group(2))
        name = f"error={_format_size(metres)}m,{_format_size(degrees)}deg"
        return Start(name, "error", metres=metres, degrees=degrees)
    if match := _GRAVITY.fullmatch(text):
        degrees = _parse_size(text, match.group(1) or str(_DEFAULT_TILT_DEG))
        return Start(f"gravity={_format_size(degrees)}deg", "gravity", degrees=degrees)
    if match := _GPS.fullmatch(text):
        metres = _parse_size(text, match.group(1))
        return Start(f"gps={_format_size(metres)}m", "gps", metres=metres)
    if text.startswith("pairs="):
        return _read_pair_list(Path(text.removeprefix("pairs=")))
    raise InputError(
        f"unknown start {text!r}: prior, none, retrieval[=K], pairs=FILE, error=3m,5deg, "
        "gravity[=3deg] or gps=50m"
    )


def _parse_size(text: str, number: str) -> float:
    """Return a number of metres or degrees of a start."""
    try:
        size = float(number)
    except ValueError:
        raise InputError(f"start {text!r}: {number!r} is not a number") from None
    if size > FARTHEST_M or (f"{number}deg" in text and size > _MAX_DEG):
        raise InputError(
            f"start {text!r}: {number} is too large: position errors are at most {FARTHEST_M:g} "
            f"metres, attitude errors {_MAX_DEG:g} degrees"
        )
    return size


def _format_size(size: float) -> str:
    """Return a number without an exponent, which ``parse_start`` cannot read."""
    return np.format_float_positional(size, trim="-")


def _reference(query: TaskQuery) -> Pose:
    """Return the reference pose of a query of a ``Dataset``."""
    assert isinstance(query, BenchmarkQuery)
    return query.reference


def _generator(name: str) -> np.random.Generator:
    """Return a random generator seeded with the name of a query."""
    return np.random.default_rng(int.from_bytes(bytes.fromhex(sha256(name))[:8], "little"))


def gravity_prior(reference: Pose, name: str, degrees: float) -> Prior:
    """Return a prior of gravity alone, such as that of a gimbal without a compass.

    Args:
        reference: true pose ``cam_from_world``, float64.
        name: name of the query, which seeds heading and direction of the error.
        degrees: angle between the prior's gravity and the true one.
    """
    rng = _generator(name)
    tilt_direction, heading = rng.uniform(0, 2 * np.pi, 2)
    axis = np.radians(degrees) * np.array([np.cos(tilt_direction), np.sin(tilt_direction), 0.0])
    tilt = so3_exp(torch.from_numpy(axis))
    heading_rotation = so3_exp(torch.tensor([0.0, 0.0, heading], dtype=torch.float64))
    return Prior(
        position=np.zeros(3),
        position_sigma=np.full(3, np.inf),
        cam_from_world_rotation=(reference.rotation @ tilt @ heading_rotation).numpy(),
        attitude_sigma_deg=max(degrees, 0.01),
        heading_sigma_deg=np.inf,
    )


def position_prior(reference: Pose, name: str, metres: float) -> Prior:
    """Return a prior of the position alone, with an error of exactly this size.

    Args:
        reference: true pose ``cam_from_world``, float64.
        name: name of the query, which seeds the direction of the error.
        metres: distance of the prior's position from the camera centre.
    """
    moved = move_prior(reference, name, metres, 0.0)
    return Prior(moved.position, moved.position_sigma)


def move_prior(reference: Pose, name: str, metres: float, degrees: float) -> Prior:
    """Return a prior with an error of exactly this size.

    Its standard deviations match the error: per axis of the position, and of the attitude.

    Args:
        reference: true pose ``cam_from_world``, float64.
        name: name of the query, which seeds the directions.
        metres: distance of the prior's position from the camera centre.
        degrees: angle between the attitudes of the prior and the camera.
    """
    direction, axis = (v / np.linalg.norm(v) for v in _generator(name).standard_normal((2, 3)))
    rotation = so3_exp(torch.from_numpy(np.radians(degrees) * axis))
    return Prior(
        position=reference.centre().numpy() + metres * direction,
        position_sigma=np.full(3, max(metres / np.sqrt(3), 0.01)),
        cam_from_world_rotation=(rotation @ reference.rotation).numpy(),
        attitude_sigma_deg=max(degrees, 0.01),
    )


def _create_retriever(
    dataset: Task, sparse_map: SparseMap, top: int, cache: Path | None
) -> Callable[[TaskQuery], tuple[str, ...]]:
    """Return a function that retrieves the ``top`` map photographs most similar to a query.

    It compares VLAD descriptors of SIFT features and is the same for every method.
    """
    sift = Sift(SiftConfig().max_features)
    with open_cache(sparse_map, dataset.images, cache) as map_cache:
        features = map_features(map_cache, sift)
    names = sparse_map.names

    def describe(row: int) -> NDArray[np.float32]:
        return sift.unit(features[names[row]].descriptors).numpy()

    index = VladIndex.build(LazyDescriptors(describe, len(names)))

    def retrieve(query: TaskQuery) -> tuple[str, ...]:
        descriptors = sift.unit(sift(read_rgb(query.image, query.camera)).descriptors)
        return tuple(names[row] for row in index.rank(descriptors.numpy(), top))

    return retrieve


def _read_pair_list(path: Path) -> Start:
    """Return the start of a pair list, named by the digest of the file."""
    pairs = read_pairs(path)
    digest = sha256(read_text(path, "pair list"))
    return Start(f"pairs={digest[:12]}", "pairs", pairs=pairs)
