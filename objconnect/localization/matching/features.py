"""Extractors of local features, and the features of a map's photographs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from objconnect.localization.cache.earlier import Earlier, kept_files, key_of
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.views import north_angle, warp_image
from objconnect.scene.localizer import MapPart
from objconnect.scene.maps.features import (
    FeatureFile,
    Features,
    feature_writer,
    features_key,
    unit_descriptors,
)
from objconnect.scene.maps.matching import match
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.digests import digests, require_unchanged
from objconnect.scene.storage.images import check_photographs, read_rgb
from objconnect.scene.storage.scratch import scratch

# Photographs whose features are in memory at once while they are extracted.
_TOGETHER = 64


class Extractor(ABC):
    """Detects and describes keypoints.

    The descriptors of this class are vectors that are compared by their angle. Subclasses with
    other descriptors override ``unit`` and ``match``.

    Attributes:
        name: name of the kind of feature, and of its cache.
        options: all other settings that change the features, as text.
        weights_sha256: digest of learned weights, or None.
        turned: whether features are invariant to rotation and scale. If not, features of pictures
            turned north up are compared, at the map's resolution.
    """

    name: str
    options: str
    weights_sha256: str | None = None
    turned: bool = True

    @abstractmethod
    def __call__(self, rgb: NDArray[np.uint8]) -> Features:
        """Extract the features of an image (H, W, 3) uint8."""

    def seen(
        self, rgb: NDArray[np.uint8], camera: Camera, angle: float, scale: float = 1.0
    ) -> Features:
        """Extract features of a photograph turned and resized, in its own pixels.

        It is turned counter-clockwise by ``angle`` (rad) and resized by ``scale``.

        The corners of the turned picture are black. Keypoints at or beyond the photograph's edge
        are dropped.
        """
        view = warp_image(rgb, camera, angle, scale)
        features = self(view.picture)
        xy = features.xy.astype(np.float64)
        kept = view.shows(xy)
        xy = view.in_photograph(xy[kept]).astype(features.xy.dtype)
        return Features(np.asarray(xy), features.scale[kept] / scale, features.descriptors[kept])

    def of_photographs(
        self,
        root: Path,
        names: Sequence[str],
        on_progress: Callable[[int], None],
        beside: Path | None = None,
    ) -> dict[str, Features]:
        """Extract features of photographs, by name.

        Args:
            root: folder of the photographs.
            names: names of the photographs.
            on_progress: receives the number of finished photographs.
            beside: folder for temporary files, as ``scratch.scratch`` takes it.

        Raises:
            InputError: a photograph is missing or damaged.
        """
        features = {}
        for done, name in enumerate(names, 1):
            features[name] = self(read_rgb(root / name))
            on_progress(done)
        return features

    def unit(self, descriptors: NDArray[Any]) -> Tensor:
        """Convert to (N, D) float32 of unit length, which ``match`` and retrieval take."""
        return unit_descriptors(descriptors)

    def match(self, a: Tensor, b: Tensor, ratio: float) -> NDArray[np.int64]:
        """Return rows (K, 2) of mutual nearest neighbours by the ratio test; see ``unit``."""
        return match(a, b, ratio)


def map_features(
    sparse_map: SparseMap,
    images: Path,
    extractor: Extractor,
    cache: Path | None,
    part: MapPart | None = None,
) -> FeatureFile:
    """Return features of the map's photographs, extracted unless the cache holds them.

    Args:
        sparse_map: the map.
        images: folder of the photographs.
        extractor: extractor of the features.
        cache: folder of files named by a digest of photographs and extractor; None takes a
            temporary file that is removed with the result.
        part: photographs whose features are enough, where the cache does not hold all; None for
            all.

    Raises:
        InputError: a photograph is missing, broken, not of its camera's size, or changed meanwhile.
    """
    if cache is None:
        with scratch() as folder:
            return map_features(sparse_map, images, extractor, folder, part)
    check_photographs(images, {name: sparse_map.images[name].camera for name in sparse_map.names})
    names = sparse_map.names
    files = [images / name for name in names]
    photographs = digests(files)
    key, own = _keys(sparse_map, extractor, photographs)
    if (kept := _kept_with_map(sparse_map, key)) is not None:
        return kept
    path = cache / f"{extractor.name}-{key[:16]}.h5"
    if path.is_file():
        return FeatureFile(path)
    wanted: Sequence[str] = names
    if part is not None:
        wanted = part.names
        path = part.folder / f"{extractor.name}-{key_of(key, *wanted)[:16]}.h5"
    earlier = Earlier(FeatureFile, FeatureFile.by_key, kept_files(cache, extractor.name))
    bar = progress_bar(f"{extractor.name} map features", len(wanted))
    with bar as advance, feature_writer(path, key if part is None else "") as add:
        left = []
        for name in wanted:
            if (item := earlier.read(own[name], FeatureFile.__getitem__)) is None:
                left.append(name)
            else:
                add(name, item, own[name])

        def advanced(done: int) -> None:
            advance(len(wanted) - len(left) + done)

        for name, item in _extracted(extractor, images, sparse_map, left, cache, advanced):
            add(name, item, own[name])
        require_unchanged(files, photographs)
    return FeatureFile(path)


def _keys(
    sparse_map: SparseMap, extractor: Extractor, photographs: Sequence[str]
) -> tuple[str, dict[str, str]]:
    """Return digests of all that features depend on: of all photographs, and of each by name.

    Args:
        sparse_map: the map of the photographs.
        extractor: extractor of the features.
        photographs: digests of their bytes, in the order of ``SparseMap.names``.
    """
    made_by = (extractor.options, extractor.weights_sha256)
    named = list(zip(sparse_map.names, photographs, strict=True))
    # How photographs are seen: those of a turned extractor, as they are.
    angles: dict[str, float] = {}
    cameras: dict[str, str] = {}
    if not extractor.turned:
        for name in sparse_map.names:
            image = sparse_map.images[name]
            angles[name] = north_angle(image.cam_from_world[:3, :3])
            cameras[name] = str(image.camera)
    own = {
        name: features_key([("", sha256)], *made_by, angles.get(name), cameras.get(name))
        for name, sha256 in named
    }
    return features_key(named, *made_by, angles, list(cameras.values())), own


def _extracted(
    extractor: Extractor,
    images: Path,
    sparse_map: SparseMap,
    names: Sequence[str],
    cache: Path,
    on_progress: Callable[[int], None],
) -> Iterator[tuple[str, Features]]:
    """Extract features of photographs, few of which are in memory at once.

    Args:
        extractor: extractor of the features.
        images: folder of the photographs.
        sparse_map: the map of the photographs.
        names: of the photographs whose features are wanted.
        cache: folder for temporary files.
        on_progress: receives the number of finished photographs.
    """
    for first in range(0, len(names), _TOGETHER if extractor.turned else 1):
        if extractor.turned:
            some = names[first : first + _TOGETHER]

            def advanced(done: int, before: int = first) -> None:
                on_progress(before + done)

            yield from extractor.of_photographs(images, some, advanced, cache).items()
            continue
        image = sparse_map.images[names[first]]
        rgb = read_rgb(images / image.name, image.camera)
        angle = north_angle(image.cam_from_world[:3, :3])
        yield image.name, extractor.seen(rgb, image.camera, angle)
        on_progress(first + 1)


def _kept_with_map(sparse_map: SparseMap, key: str) -> FeatureFile | None:
    """Return the features that a map was built from, where they are those of a key."""
    if sparse_map.features is None:
        return None
    try:
        kept = FeatureFile(sparse_map.features)
    except InputError:  # without them, they are extracted
        return None
    return kept if kept.made_of == key else None
