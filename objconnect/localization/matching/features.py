"""Extractors of local features, and the features of a map's photographs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from objconnect.localization.cache.map_cache import EarlierRows, MapCache
from objconnect.localization.cache.store import Arrays, Rows, Store
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.views import north_angle, warp_image
from objconnect.scene.maps.features import (
    FeatureFile,
    Features,
    features_key,
    unit_descriptors,
)
from objconnect.scene.maps.matching import match
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.digests import digest_of
from objconnect.scene.storage.images import read_rgb

# Number of photographs whose features are extracted, and in memory, at once.
_BATCH_PHOTOGRAPHS = 64
_ARRAYS = ("xy", "scale", "descriptors")


class Extractor(ABC):
    """Detects and describes keypoints.

    By default, descriptors are vectors that are compared by their angle. Subclasses with other
    descriptors override ``unit`` and ``match``.

    Attributes:
        name: name of the kind of feature, and of its cache files.
        options: all settings that change the features, as text.
        rotation_invariant: whether features are invariant to rotation and scale. If not, they are
            extracted from pictures that are rotated north up, and queries are resized to the map's
            resolution too.
        tilt_invariant: whether features are matched across tilts. If not, reference images of
            similar tilt come first where the query's attitude is known.
        headings: number of evenly spaced headings that are tried where the heading is unknown; 0
            tries the headings of the reference images. Only for features that are not
            rotation-invariant.
    """

    name: str
    options: str
    rotation_invariant: bool = True
    tilt_invariant: bool = True
    headings: int = 0

    @property
    def weights_sha256(self) -> str | None:
        """Return the digest of learned weights; None if there are none."""
        return None

    @property
    def identity(self) -> tuple[object, ...]:
        """Return the settings that affect the features, for the key of the cache."""
        return self.options, self.weights_sha256, self.rotation_invariant

    @abstractmethod
    def __call__(self, rgb: NDArray[np.uint8]) -> Features:
        """Extract the features of an image (H, W, 3) uint8 RGB; pixels are COLMAP's."""

    def extract_warped(
        self, rgb: NDArray[np.uint8], camera: Camera, angle: float, scale: float = 1.0
    ) -> Features:
        """Extract features of a rotated and resized photograph, in pixels of the original.

        It is rotated counter-clockwise by ``angle`` (rad) and resized by ``scale``. The corners of
        the rotated picture are black. Keypoints beyond the photograph's edge or less than
        ``views.MARGIN`` from it are dropped.
        """
        view = warp_image(rgb, camera, angle, scale)
        features = self(view.picture)
        xy = features.xy.astype(np.float64)
        kept = view.shows(xy)
        xy = view.in_photograph(xy[kept]).astype(features.xy.dtype)
        return Features(np.asarray(xy), features.scale[kept] / scale, features.descriptors[kept])

    def extract_photographs(
        self,
        root: Path,
        names: Sequence[str],
        on_progress: Callable[[int], None],
        temporary_root: Path | None = None,
    ) -> dict[str, Features]:
        """Extract features of photographs, by name.

        Args:
            root: folder of the photographs.
            names: names of the photographs.
            on_progress: receives the number of finished photographs.
            temporary_root: folder for temporary files, as ``parent`` of ``scratch.scratch``.

        Raises:
            InputError: a photograph is missing or damaged.
        """
        features = {}
        for done, name in enumerate(names, 1):
            features[name] = self(read_rgb(root / name))
            on_progress(done)
        return features

    def unit(self, descriptors: NDArray[Any]) -> Tensor:
        """Convert descriptors to (N, D) float32 of unit length for ``match`` and retrieval."""
        return unit_descriptors(descriptors)

    def match(self, a: Tensor, b: Tensor, ratio: float) -> NDArray[np.int64]:
        """Return rows (K, 2) of mutual nearest neighbours that pass the ratio test.

        Args:
            a: (N, D) from ``unit``.
            b: (M, D) from ``unit``.
            ratio: largest ratio of nearest to second nearest distance.
        """
        return match(a, b, ratio)


class CachedFeatures(Mapping[str, Features]):
    """Features of photographs by name, in a file of the cache; each is read on access.

    Threads may share it.

    Args:
        store: the file.
        keys: key of the row of each photograph.
    """

    def __init__(self, store: Store, keys: Mapping[str, str]) -> None:
        self._store, self._keys = store, keys

    def __getitem__(self, name: str) -> Features:
        return Features(**self._store.arrays(self._store.row(self._keys[name]), _ARRAYS))

    def __iter__(self) -> Iterator[str]:
        return iter(self._keys)

    def __len__(self) -> int:
        return len(self._keys)


def map_features(map_cache: MapCache, extractor: Extractor) -> Mapping[str, Features]:
    """Return features of the map's photographs, extracted unless the map or the cache holds them.

    If the cache is for a part of the photographs, features of the others may be missing.

    Raises:
        InputError: a photograph is damaged or changed meanwhile, or a file of the cache is damaged.
    """
    if (built_from := _reuse_map_features(map_cache, extractor)) is not None:
        return built_from
    if map_cache.holds(extractor.name, *extractor.identity):
        map_cache = map_cache.whole
    keys = {name: _key(map_cache, extractor, name) for name in map_cache.names}

    def rows(read_earlier: EarlierRows) -> Rows:
        names, size = map_cache.names, _BATCH_PHOTOGRAPHS if extractor.rotation_invariant else 1
        with progress_bar(f"{extractor.name} map features", len(names)) as advance:
            for first in range(0, len(names), size):
                batch = names[first : first + size]
                features: dict[str, Arrays] = {
                    name: known
                    for name in batch
                    if (known := read_earlier(keys[name], _ARRAYS)) is not None
                }
                missing = [name for name in batch if name not in features]
                if missing:

                    def advance_by(done: int, before: int = first + len(features)) -> None:
                        advance(before + done)

                    features |= _extract_all(extractor, map_cache, missing, advance_by)
                yield from ((keys[name], features[name]) for name in batch)
                advance(first + len(batch))

    return CachedFeatures(map_cache.store(extractor.name, *extractor.identity, rows=rows), keys)


def _key(map_cache: MapCache, extractor: Extractor, name: str) -> str:
    """Return a digest of all inputs of a photograph's features."""
    image = map_cache.sparse_map.images[name]
    warp: tuple[object, ...] = ()
    if not extractor.rotation_invariant:
        warp = north_angle(image.cam_from_world[:3, :3]), image.camera
    return digest_of(*extractor.identity, map_cache.digests[name], *warp)


def _extract_all(
    extractor: Extractor,
    map_cache: MapCache,
    names: Sequence[str],
    on_progress: Callable[[int], None],
) -> dict[str, Arrays]:
    """Extract features of photographs and return them all, by name."""
    if extractor.rotation_invariant:
        by_name = extractor.extract_photographs(
            map_cache.images, names, on_progress, map_cache.folder
        )
        return {name: vars(features) for name, features in by_name.items()}
    extracted: dict[str, Arrays] = {}
    for name in names:
        image = map_cache.sparse_map.images[name]
        rgb = read_rgb(map_cache.images / name, image.camera)
        angle = north_angle(image.cam_from_world[:3, :3])
        extracted[name] = vars(extractor.extract_warped(rgb, image.camera, angle))
    return extracted


def _reuse_map_features(map_cache: MapCache, extractor: Extractor) -> FeatureFile | None:
    """Return the features that a map was built from if the extractor would give the same."""
    path = map_cache.sparse_map.features
    if path is None or extractor.weights_sha256 is not None or not extractor.rotation_invariant:
        return None
    try:
        file = FeatureFile(path)
    except InputError:  # The file is damaged; the features are extracted instead.
        return None
    return (
        file if file.inputs_digest == features_key(map_cache.digests, extractor.options) else None
    )
