"""Retrieval of reference images for a query by its prior or by appearance.

The global descriptor is a VLAD of the map's own descriptors (Jegou et al., "Aggregating local
descriptors into a compact image representation", CVPR 2010) with the power and intra-normalisation
of Arandjelovic and Zisserman ("All about VLAD", CVPR 2013). It needs no download and no training on
other data.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.nearest import NearestNeighbours
from objconnect.scene.geometry.views import rotate_north_up
from objconnect.scene.localizer import Prior, Query
from objconnect.scene.maps.sparse_map import SparseMap

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Rows = NDArray[np.int64]
QueryDescriptors = NDArray[np.float32] | Sequence[NDArray[np.float32]]
"""Unit descriptors (n, D) of a query, or one such array for each rotation of its picture."""

NO_REFERENCE: Final = (
    "no reference image: the map has no photograph, or the query's list of references is empty"
)
"""Reason of the failure of a query without a reference image."""
# Number of visual words of the VLAD.
_WORDS: Final = 64
# Maximum number of descriptors that are clustered to visual words.
_TRAINING_DESCRIPTORS: Final = 40_000
# Maximum number of photographs whose VLADs span the space of the global descriptors. It bounds
# memory for large maps.
_SPANNING: Final = 512
# Distance from a prior's position, in standard deviations, within which photographs are candidates.
_REACH_SIGMAS: Final = 2.0
# Lower bound of the height of a camera above the ground, metres.
_MIN_HEIGHT_M: Final = 2.0
# Lower bound of the cosine of the tilt, for the intersection of optical axis and ground.
_MIN_TILT_COSINE: Final = 0.3


class Descriptors(Protocol):
    """A sequence of arrays of unit descriptors (n, D), one array per photograph."""

    def __len__(self) -> int: ...

    def __getitem__(self, row: int, /) -> NDArray[np.float32]: ...


@dataclass(frozen=True)
class LazyDescriptors:
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
        vectors: (N, L) VLADs of all photographs, projected to that space. The projection is exact
            if L is N, else Nystrom's approximation (Williams and Seeger, NIPS 2000).
    """

    words: NDArray[np.float32]
    basis: NDArray[np.float32]
    vectors: NDArray[np.float32]

    @staticmethod
    def build(
        descriptors: Descriptors, words: int = _WORDS, spanning: int = _SPANNING
    ) -> VladIndex:
        """Cluster the descriptors of all photographs and describe each by its residuals.

        Args:
            descriptors: descriptors of the photographs, which are read one photograph at a time.
            words: maximum number of visual words.
            spanning: maximum number of photographs that span the space of the VLADs.

        Examples:
            Two photographs with two descriptors each; a query like the second finds it:

            >>> first = np.array([[1.0, 0.0], [0.8, 0.6]], np.float32)
            >>> second = np.array([[0.0, 1.0], [0.6, 0.8]], np.float32)
            >>> index = VladIndex.build([first, second], words=1)
            >>> index.rank(second, k=1).tolist()
            [1]
        """
        sample = _training_sample(descriptors, _TRAINING_DESCRIPTORS)
        # If no photograph has a keypoint, there are no words, and all VLADs are empty.
        learned = _cluster(sample, min(words, len(sample))) if len(sample) else sample
        count = len(descriptors)
        rows = np.linspace(0, count - 1, min(count, spanning)).astype(int)
        span = {row: _vlad(descriptors[row], learned) for row in rows.tolist()}
        basis = np.asarray(np.linalg.qr(np.stack([*span.values()]).T)[0], np.float32)
        vectors = [
            (span[row] if row in span else _vlad(descriptors[row], learned)) @ basis
            for row in range(count)
        ]
        return VladIndex(learned, basis, np.stack(vectors))

    def rank(self, descriptors: QueryDescriptors, k: int, among: Rows | None = None) -> Rows:
        """Return the rows of the ``k`` most similar photographs, best first.

        Args:
            descriptors: (n, D) unit descriptors of the query, or one such array for each rotation
                of its picture. Of several rotations, the one most similar to a photograph is used.
            k: number of photographs.
            among: rows of the photographs to choose from; None for all.
        """
        vectors = self.vectors if among is None else self.vectors[among]
        views = [descriptors] if isinstance(descriptors, np.ndarray) else descriptors
        similarity = [vectors @ (_vlad(view, self.words) @ self.basis) for view in views]
        best = _smallest(-np.max(similarity, axis=0), k)
        return best if among is None else among[best]


def _training_sample(descriptors: Descriptors, count: int) -> NDArray[np.float32]:
    """Return all descriptors (n, D), or a random sample if they are more than ``count``."""
    photographs = range(len(descriptors))
    ends = np.cumsum([len(descriptors[row]) for row in photographs])
    if ends[-1] <= count:
        return np.concatenate([descriptors[row] for row in photographs])
    rows = np.random.default_rng(0).choice(ends[-1], count, replace=False)
    owner = np.searchsorted(ends, rows, "right")
    sample = np.empty((len(rows), descriptors[int(owner[0])].shape[1]), np.float32)
    for row in np.unique(owner):
        in_sample = np.flatnonzero(owner == row)
        # The index is negative; it counts from the end of the photograph's descriptors.
        sample[in_sample] = descriptors[int(row)][rows[in_sample] - ends[row]]
    return sample


def _cluster(descriptors: NDArray[np.float32], k: int) -> NDArray[np.float32]:
    if k == len(descriptors):
        return descriptors  # OpenCV would read (1, D) as D samples.
    cv2.setRNGSeed(0)
    criteria = (cv2.TERM_CRITERIA_MAX_ITER + cv2.TERM_CRITERIA_EPS, 15, 1e-3)
    _, _, words = cv2.kmeans(descriptors, k, None, criteria, 1, cv2.KMEANS_PP_CENTERS)
    return np.asarray(words, np.float32)


def _vlad(descriptors: NDArray[np.float32], words: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the VLAD (K*D,) of descriptors (n, D) over words (K, D), of unit length or 0."""
    if not len(descriptors) or not len(words):
        return np.zeros(words.size, np.float32)
    # The nearest word by squared distance; the descriptor's length is the same for all words.
    nearest = (descriptors @ words.T - 0.5 * (words**2).sum(1)).argmax(1)
    # Sums over the descriptors of each word, as a matrix product.
    belongs = (nearest[:, None] == np.arange(len(words))).astype(np.float32)
    vlad = belongs.T @ descriptors - belongs.sum(0)[:, None] * words
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
        self._nearest = NearestNeighbours(sparse_map.centres[:, :2])
        poses = (sparse_map.images[name].cam_from_world for name in sparse_map.names)
        self._rotations_north_up = np.array(
            [rotate_north_up(pose[:3, :3]) for pose in poses]
        ).reshape(-1, 3, 3)

    def nearest(self, position: Vector, k: int) -> Rows:
        """Return the rows of the ``k`` cameras horizontally nearest to a position (3,).

        The nearest comes first. Altitude is ignored: it has little influence on the ground in view,
        and GNSS altitude is the least reliable axis.
        """
        return self._nearest(position[:2], k)

    def within(self, position: Vector, metres: float) -> Rows:
        """Return the rows of the cameras within a horizontal distance of a position (3,)."""
        return self._nearest.within(position[:2], metres)

    def most_similar(self, position: Vector, rotation: Matrix, k: int) -> Rows:
        """Return rows of the ``k`` cameras whose north-up views are most similar to that of a pose.

        The distance of two views is the distance of their centres on the ground divided by the
        height above ground, plus the angle between the cameras rotated north up, in radians. It is
        about 1 if the centres differ by the width of a picture, or the tilts by 60 degrees. The
        best comes first.

        Args:
            position: (3,) camera centre, world metres.
            rotation: (3, 3) ``cam_from_world``.
            k: number of photographs.
        """
        rotation = rotate_north_up(rotation)
        height = max(self._map.height_above(position), _MIN_HEIGHT_M)
        ground = position[2] - height
        view_centres = _view_centres(self._map.centres, self._rotations_north_up, ground)
        view_centre = _view_centres(position[None], rotation[None], ground)
        shift = np.linalg.norm(view_centres - view_centre, axis=1)
        cosine = (self._rotations_north_up.reshape(-1, 9) @ rotation.ravel() - 1) / 2
        angle = np.arccos(np.clip(cosine, -1, 1))
        return _smallest(shift / height + angle, k)


def _smallest(values: NDArray[Any], k: int) -> Rows:
    """Return the rows of the ``k`` least values in ascending order; ties keep their order."""
    if k >= len(values):
        return np.argsort(values, kind="stable")
    rows = np.flatnonzero(values <= np.partition(values, k - 1)[k - 1])
    return np.asarray(rows[np.argsort(values[rows], kind="stable")][:k])


def _view_centres(centres: Vector, rotations: Matrix, ground: float) -> Vector:
    """Return the points (N, 2) where optical axes meet level ground.

    Axes near the horizon have a point at a limited distance instead.

    Args:
        centres: (N, 3) camera centres, world metres.
        rotations: (N, 3, 3) ``cam_from_world``.
        ground: height of the ground, world metres.
    """
    axis = rotations[:, 2]
    reach = np.maximum(centres[:, 2] - ground, 0) / np.maximum(-axis[:, 2], _MIN_TILT_COSINE)
    return np.asarray(centres[:, :2] + reach[:, None] * axis[:, :2])


@dataclass(frozen=True)
class References:
    """Chooses the reference images of a query among the photographs of a map.

    Attributes:
        names: names of the photographs.
        viewpoints: positions of the photographs.
        index: global descriptors of the photographs.
    """

    names: tuple[str, ...]
    viewpoints: Viewpoints
    index: VladIndex

    @staticmethod
    def build(sparse_map: SparseMap, descriptors: Descriptors) -> References:
        """Index the photographs by their descriptors, in the order of ``sparse_map.names``."""
        index = VladIndex.build(descriptors)
        return References(sparse_map.names, Viewpoints(sparse_map), index)

    def choose(
        self,
        query: Query,
        k: int,
        describe: Callable[[], QueryDescriptors],
        tilt_invariant: bool = True,
    ) -> NDArray[np.int64]:
        """Return the rows of reference images in ``names``, best first.

        They are the images in the query's list, even if the list is empty. Without a list (None),
        they are the ``k`` photographs nearest to its prior, and without a prior position the ``k``
        most similar photographs. If more than ``k`` photographs lie within two standard deviations
        of the prior, the ``k`` most similar of these are returned, because the nearest are no
        better than the others.

        Args:
            query: the query.
            k: number of photographs.
            describe: returns the query's descriptors for ``VladIndex.rank``; called only when
                needed.
            tilt_invariant: whether features are invariant to tilt. If not, and if the prior has a
                heading, the photographs with the most similar views come first.

        Raises:
            InputError: the query names a photograph that the map does not have.
        """
        if query.references is not None:
            unknown = [name for name in query.references if name not in self._row]
            if unknown:
                raise InputError(
                    f"{query.name}: the map has no photograph {unknown[0]}, which is named as a "
                    "reference image"
                )
            return np.array([self._row[name] for name in query.references], np.int64)
        if query.prior is not None and query.prior.has_position:
            rotation = query.prior.cam_from_world_rotation
            if rotation is not None and query.prior.has_heading and not tilt_invariant:
                return self.viewpoints.most_similar(query.prior.position, rotation, k)
            near = self._find_within_reach(query.prior)
            if len(near) > k and any(map(len, described := describe())):
                return self.index.rank(described, k, near)
            return self.viewpoints.nearest(query.prior.position, k)
        return self.index.rank(describe(), k)

    def _find_within_reach(self, prior: Prior) -> Rows:
        """Return the rows of the photographs within two standard deviations of a prior; none if its
        sigma is unknown."""
        sigma = prior.horizontal_sigma
        if sigma is None:
            return np.zeros(0, np.int64)
        return self.viewpoints.within(prior.position, _REACH_SIGMAS * sigma)

    @cached_property
    def _row(self) -> dict[str, int]:
        return {name: row for row, name in enumerate(self.names)}
