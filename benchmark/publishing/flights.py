"""Flights as rows: the photographs of the map, and the queries."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.datasets.dataset import BenchmarkQuery, Dataset
from benchmark.datasets.flight import photograph_conditions
from benchmark.datasets.identity import digest_values
from benchmark.datasets.simulated import query_of
from benchmark.publishing.layers import PublishedLayer
from benchmark.publishing.rows import SceneRows
from objconnect.scene.bundle.frames import (
    FRAME_SHAPES,
    DenseLayers,
    Frames,
    check_arrays,
)
from objconnect.scene.bundle.manifest import Splits
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Prior
from objconnect.scene.maps.sparse_map import SparseMap


@dataclass(frozen=True)
class FlightSession:
    """A session of a flight: its map photographs or its queries.

    Attributes:
        condition: condition of the photographs that have no condition of their own.
        flight: kind of flight; the files do not state it.
        readout_s: seconds of the readout; the files do not state it.
        thermal: None, because flights have no thermal pictures.
    """

    condition: str
    flight: str = "unknown"
    readout_s: float = 0.0
    thermal: None = None


@dataclass(frozen=True)
class Flight:
    """A flight with the attributes of a scene; see ``benchmark.publishing.rows.SceneOrFlight``.

    Its sessions are the map's photographs and the queries.
    """

    name: str
    path: Path
    images_root: Path
    splits: Splits
    sessions: Mapping[str, FlightSession]

    def layers(self, session: str) -> AbstractContextManager[DenseLayers]:
        """Refuse to open layers, which flights do not have.

        Raises:
            InputError: always.
        """
        raise InputError(f"flight {self.path} has no layers: leave out --layer")


def flight_rows(path: Path, dataset: Dataset, layers: Sequence[PublishedLayer]) -> SceneRows:
    """Return a flight as rows.

    Args:
        path: folder of the flight.
        dataset: its data set.
        layers: layers to publish; ``Flight.layers`` refuses them.

    Raises:
        InputError: a prior or a pose cannot be stored as a row.
    """
    sparse_map, name = dataset.load_map(), dataset.name
    names = tuple(query.name for query in dataset.queries)
    map_session = f"{name}-map"
    frames = {map_session: _map_frames(sparse_map), name: _query_frames(dataset.queries)}
    for session in frames.values():
        check_arrays(path, session.names, {key: getattr(session, key) for key in FRAME_SHAPES})
    _require_lossless(path, dataset.queries, frames[name])
    flight = Flight(
        name=name,
        path=path,
        images_root=dataset.images,
        splits=Splits(map=sparse_map.names, queries={name: names}),
        sessions={
            map_session: FlightSession(dataset.map_conditions[0]),
            name: FlightSession(dataset.queries[0].condition),
        },
    )
    conditions = photograph_conditions(path, sparse_map.images.keys(), {*names})
    return SceneRows(flight, frames, layers, conditions)


def _map_frames(sparse_map: SparseMap) -> Frames:
    """Return the photographs of a map, whose times and priors are unknown."""
    images = [sparse_map.images[name] for name in sparse_map.names]
    unknown = {key: np.full((len(images), *shape), np.nan) for key, shape in FRAME_SHAPES.items()}
    unknown["cam_from_world"] = np.stack([image.cam_from_world for image in images])
    return Frames(sparse_map.names, tuple(image.camera for image in images), **unknown)


def _query_frames(queries: Sequence[BenchmarkQuery]) -> Frames:
    arrays = {key: np.full((len(queries), *shape), np.nan) for key, shape in FRAME_SHAPES.items()}
    for k, query in enumerate(queries):
        arrays["cam_from_world"][k] = query.reference.matrix().numpy()
        if query.prior is not None:
            for key, value in _yield_known_values(query.prior):
                arrays[key][k] = value
    return Frames(
        tuple(query.name for query in queries), tuple(query.camera for query in queries), **arrays
    )


def _yield_known_values(prior: Prior) -> Iterator[tuple[str, NDArray[np.float64] | float]]:
    """Yield the known values of a prior by the names of the attributes of ``Frames``."""
    if prior.position_sigma is not None:
        yield "gps_prior", prior.position
        yield "gps_sigma", prior.position_sigma
    if prior.cam_from_world_rotation is not None and prior.attitude_sigma_deg is not None:
        rotation = torch.from_numpy(prior.cam_from_world_rotation)
        attitude = Pose(rotation, torch.zeros(3, dtype=torch.float64)).quaternion()
        yield "attitude_prior", attitude.numpy()
        yield "attitude_sigma_deg", prior.attitude_sigma_deg


def _require_lossless(path: Path, queries: Sequence[BenchmarkQuery], frames: Frames) -> None:
    """Check that the stored rows reproduce the queries' priors and poses."""
    for k, query in enumerate(queries):
        stored = query_of(frames, k, query.image, query.group, query.condition, f"flight {path}")
        if digest_values(stored) != digest_values(query):
            raise InputError(
                f"flight {path}: the prior of {query.name} cannot be published: give sigmas for "
                "position and full attitude; a sigma for heading only is not supported"
            )
