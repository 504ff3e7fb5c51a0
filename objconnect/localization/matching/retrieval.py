"""Retrieval of reference images for a query by its prior or by appearance.

The global descriptor is a VLAD of the map's own descriptors (Jegou et al., "Aggregating local
descriptors into a compact image representation", CVPR 2010) with the power and intra-normalisation
of Arandjelovic and Zisserman ("All about VLAD", CVPR 2013). It needs no download and no training on
other data.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.nearest import Nearest
from objconnect.scene.geometry.views import upright
from objconnect.scene.localizer import Prior, Query
from objconnect.scene.maps.sparse_map import SparseMap

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Rows = NDArray[np.int64]


# Number of visual words of the VLAD, and maximum number of descriptors to cluster.
_WORDS: Final = 64
_TRAINING_DESCRIPTORS: Final = 40_000
# Photographs whose VLADs span the space in which larger maps are described, which bounds memory.
_SPANNING: Final = 512
# Distance from a prior's position, in standard deviations, within which photographs are candidates.
_REACH_SIGMAS: Final = 2.0
# Least height above the ground that a camera is assumed to have, metres.
_MIN_HEIGHT_M: Final = 2.0
# Lower bound of the cosine of the tilt when an optical axis is intersected with the ground.
_MIN_TILT_COSINE: Final = 0.3


class Described(Protocol):
    """A sequence of unit descriptors (n, D), one entry per photograph."""

    def __len__(self) -> int: ...

    def __getitem__(self, row: int, /) -> NDArray[np.float32]: ...


@dataclass(frozen=True)
class OnDemand:
    """Descriptors of ``count`` photographs, each read on access."""

    read: Callable[[int], NDArray[np.float32]]
    count: int

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, row: int) -> NDArray[np.float32]:
        return self.read(row)


@dataclass(frozen=True)
class VladIndex:
    """Global descriptors of the photographs of a map.

    Attributes:
        words: (K, D) visual words.
        basis: (K*D, L) orthonormal basis of the space that the VLADs of L photographs span.
        vectors: (N, L) VLADs in that space, one per photograph. They are exact if L is N, else
            Nystrom's approximation (Williams and Seeger, NIPS 2000).
    """

    words: NDArray[np.float32]
    basis: NDArray[np.float32]
    vectors: NDArray[np.float32]

    @staticmethod
    def build(descriptors: Described, words: int = _WORDS, spanning: int = _SPANNING) -> VladIndex:
        """Cluster the descriptors of all photographs and describe each by its residuals.

        Args:
            descriptors: descriptors of each photograph, read one photograph at a time.
            words: maximum number of visual words.
            spanning: maximum number of photographs that span the space of the VLADs.

        Example:
            Two photographs with two descriptors each; a query like the second finds it:

            >>> first = np.array([[1.0, 0.0], [0.8, 0.6]], np.float32)
            >>> second = np.array([[0.0, 1.0], [0.6, 0.8]], np.float32)
            >>> index = VladIndex.build([first, second], words=1)
            >>> index.rank(second, k=1).tolist()
            [1]
        """
        some = _training_sample(descriptors, _TRAINING_DESCRIPTORS)
        # Without any keypoint there are no words, and all VLADs are equal.
        learned = _cluster(some, min(words, len(some))) if len(some) else some
        count = len(descriptors)
        rows = np.linspace(0, count - 1, min(count, spanning)).astype(int)
        span = np.stack([_vlad(descriptors[int(row)], learned) for row in rows])
        basis = np.asarray(np.linalg.qr(span.T)[0], np.float32)
        vectors = [_vlad(descriptors[row], learned) @ basis for row in range(count)]
        return VladIndex(learned, basis, np.stack(vectors))

    def rank(self, descriptors: NDArray[np.float32], k: int, among: Rows | None = None) -> Rows:
        """Return the rows of the ``k`` most similar photographs, best first.

        Args:
            descriptors: (n, D) unit descriptors of the query.
            k: number of photographs.
            among: rows of the photographs to choose from; None for all.
        """
        vectors = self.vectors if among is None else self.vectors[among]
        best = _least(-(vectors @ (_vlad(descriptors, self.words) @ self.basis)), k)
        return best if among is None else among[best]


def _training_sample(descriptors: Described, most: int) -> NDArray[np.float32]:
    """Return all descriptors, or a random sample of ``most``."""
    every = range(len(descriptors))
    ends = np.cumsum([len(descriptors[row]) for row in every])
    if ends[-1] <= most:
        return np.concatenate([descriptors[row] for row in every])
    rows = np.random.default_rng(0).choice(ends[-1], most, replace=False)
    owner = np.searchsorted(ends, rows, "right")
    some = np.empty((len(rows), descriptors[int(owner[0])].shape[1]), np.float32)
    for row in np.unique(owner):
        taken = np.flatnonzero(owner == row)
        # Negative: counted from the end of a photograph's own.
        some[taken] = descriptors[int(row)][rows[taken] - ends[row]]
    return some


def _cluster(descriptors: NDArray[np.float32], k: int) -> NDArray[np.float32]:
    if k == len(descriptors):
        return descriptors  # OpenCV would read a single descriptor as many numbers.
    cv2.setRNGSeed(0)
    criteria = (cv2.TERM_CRITERIA_MAX_ITER + cv2.TERM_CRITERIA_EPS, 15, 1e-3)
    _, _, words = cv2.kmeans(descriptors, k, None, criteria, 1, cv2.KMEANS_PP_CENTERS)
    return np.asarray(words, np.float32)


def _vlad(descriptors: NDArray[np.float32], words: NDArray[np.float32]) -> NDArray[np.float32]:
    if not len(descriptors) or not len(words):
        return np.zeros(words.size, np.float32)
    # Nearest word by squared distance, without the descriptor's own constant length.
    nearest = (descriptors @ words.T - 0.5 * (words**2).sum(1)).argmax(1)
    vlad = np.zeros_like(words)
    np.add.at(vlad, nearest, descriptors - words[nearest])
    vlad = np.sign(vlad) * np.sqrt(np.abs(vlad))
    vlad /= np.maximum(np.linalg.norm(vlad, axis=1, keepdims=True), 1e-12)
    flat = vlad.ravel()
    return np.asarray(flat / max(float(np.linalg.norm(flat)), 1e-12), np.float32)


class Viewpoints:
    """The positions of a map's photographs, and where they look at the ground.

    Args:
        sparse_map: the map; rows are those of its ``names``.
    """

    def __init__(self, sparse_map: SparseMap) -> None:
        self._map = sparse_map
        self._nearest = Nearest(sparse_map.centres[:, :2])
        poses = (sparse_map.images[name].cam_from_world for name in sparse_map.names)
        self._upright = np.array([upright(pose[:3, :3]) for pose in poses]).reshape(-1, 3, 3)

    def near(self, position: Vector, k: int) -> Rows:
        """Return the rows of the ``k`` cameras horizontally nearest to a position (3,).

        The nearest comes first. Altitude is ignored: it has little influence on the ground in view,
        and GNSS altitude is the least reliable axis.
        """
        return self._nearest(position[:2], k)

    def within(self, position: Vector, metres: float) -> Rows:
        """Return the rows of the cameras within a horizontal distance of a position (3,)."""
        return self._nearest.within(position[:2], metres)

    def alike(self, position: Vector, rotation: Matrix, k: int) -> Rows:
        """Return rows of the ``k`` cameras whose view, north up, is most like that of a pose.

        The distance of two views is that between their centres on the ground in heights above it,
        plus the remaining angle between the cameras in radians: a picture is about as wide as its
        camera is high, and differs about as much when it is tilted by 60 degrees. The best comes
        first.

        Args:
            position: (3,) camera centre, world metres.
            rotation: (3, 3) ``cam_from_world``.
            k: number of photographs.
        """
        rotation = upright(rotation)
        height = max(self._map.height_above(position), _MIN_HEIGHT_M)
        ground = position[2] - height
        middles = _middle(self._map.centres, self._upright, ground)
        own = _middle(position[None], rotation[None], ground)
        shift = np.linalg.norm(middles - own, axis=1)
        cosine = (self._upright.reshape(-1, 9) @ rotation.ravel() - 1) / 2
        turn = np.arccos(np.clip(cosine, -1, 1))
        return _least(shift / height + turn, k)


def _least(values: NDArray[Any], k: int) -> Rows:
    """Return the rows of the ``k`` least values in ascending order; ties keep their order."""
    if k >= len(values):
        return np.argsort(values, kind="stable")
    rows = np.flatnonzero(values <= np.partition(values, k - 1)[k - 1])
    return np.asarray(rows[np.argsort(values[rows], kind="stable")][:k])


def _middle(centres: Vector, rotations: Matrix, ground: float) -> Vector:
    """Return where optical axes meet level ground, (N, 2); for flat views, a point ahead."""
    axis = rotations[:, 2]
    reach = np.maximum(centres[:, 2] - ground, 0) / np.maximum(-axis[:, 2], _MIN_TILT_COSINE)
    return np.asarray(centres[:, :2] + reach[:, None] * axis[:, :2])


@dataclass(frozen=True)
class References:
    """Chooses the reference images of a query among the photographs of a map."""

    names: tuple[str, ...]
    viewpoints: Viewpoints
    index: VladIndex

    @staticmethod
    def build(sparse_map: SparseMap, descriptors: Described) -> References:
        """Index the photographs by their descriptors, in the order of ``sparse_map.names``."""
        index = VladIndex.build(descriptors)
        return References(sparse_map.names, Viewpoints(sparse_map), index)

    def choose(
        self,
        query: Query,
        k: int,
        describe: Callable[[], NDArray[np.float32]],
        tilted: bool = True,
    ) -> NDArray[np.int64]:
        """Return rows of ``names``, best first.

        They are those the query names; else the ``k`` nearest to its prior; else the ``k`` most
        similar ones. If more than ``k`` photographs lie within two standard deviations of the
        prior, they are the most similar of these, because the nearest are no better than the
        others.

        Args:
            query: the query.
            k: number of photographs.
            describe: returns unit descriptors (n, D) of the query; called only when needed.
            tilted: whether features are invariant to tilt. If not, photographs near the prior with
                a similar tilt come first.

        Raises:
            InputError: the query names a photograph that the map does not have.
        """
        if query.references is not None:
            unknown = [name for name in query.references if name not in self._row]
            if unknown:
                raise InputError(f"{query.name}: the map has no photograph {unknown[0]}")
            return np.array([self._row[name] for name in query.references], np.int64)
        if query.prior is not None and query.prior.has_position:
            rotation = query.prior.cam_from_world_rotation
            if rotation is not None and query.prior.has_heading and not tilted:
                return self.viewpoints.alike(query.prior.position, rotation, k)
            within = self._within_reach(query.prior)
            if len(within) > k and len(described := describe()):
                return self.index.rank(described, k, within)
            return self.viewpoints.near(query.prior.position, k)
        return self.index.rank(describe(), k)

    def _within_reach(self, prior: Prior) -> Rows:
        """Return the rows of the photographs within reach of a prior; none if its sigma is
        unknown."""
        sigma = prior.horizontal_sigma
        if sigma is None:
            return np.zeros(0, np.int64)
        return self.viewpoints.within(prior.position, _REACH_SIGMAS * sigma)

    @cached_property
    def _row(self) -> dict[str, int]:
        return {name: row for row, name in enumerate(self.names)}
