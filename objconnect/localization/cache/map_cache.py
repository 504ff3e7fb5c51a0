"""Files of the cache that are made of a map and its photographs."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from objconnect.localization.cache.array_store import ArrayStore
from objconnect.localization.cache.earlier import Earlier, kept_files
from objconnect.scene.localizer import MapPart
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.digests import digests, require_unchanged
from objconnect.scene.storage.images import check_photographs


@dataclass(frozen=True)
class MapCache:
    """Names files of the cache by a digest of all that they are made of.

    Attributes:
        folder: of the cache.
        files: the map's photographs.
        digests: of their bytes, by name, in the order of ``SparseMap.names``.
        map_sha256: digest of the map.
        part: the photographs that are prepared; None for all.
    """

    folder: Path
    files: tuple[Path, ...]
    digests: dict[str, str]
    map_sha256: str
    part: MapPart | None = None

    @staticmethod
    def of(sparse_map: SparseMap, images: Path, folder: Path) -> MapCache:
        """Read a map's photographs.

        Args:
            sparse_map: the map.
            images: folder that the names of its photographs are relative to.
            folder: of the cache.

        Raises:
            InputError: a photograph is missing, broken or not of its camera's size.
        """
        cameras = {name: sparse_map.images[name].camera for name in sparse_map.names}
        check_photographs(images, cameras)
        files = tuple(images / name for name in sparse_map.names)
        by_name = dict(zip(sparse_map.names, digests(files), strict=True))
        return MapCache(folder, files, by_name, sparse_map.sha256)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the photographs that are prepared."""
        return tuple(self.digests if self.part is None else self.part.names)

    def path(self, prefix: str, version: int, *parts: object) -> Path:
        """Return the path of a file of the photographs that are prepared.

        Args:
            prefix: its name before the digest.
            version: of its format.
            parts: whatever else decides its content.
        """
        photographs = list(self.digests.values())
        words = " ".join(map(str, (version, self.map_sha256, photographs, *parts)))
        folder = self.folder
        if self.part is not None:
            folder, words = self.part.folder, f"{words} {self.names}"
        return folder / f"{prefix}-{hashlib.sha256(words.encode()).hexdigest()[:16]}.h5"

    def earlier(self, prefix: str) -> Earlier[ArrayStore, int]:
        """Return what files of a prefix hold, whatever map they were made of."""
        return Earlier(ArrayStore, ArrayStore.by_key, kept_files(self.folder, prefix))

    def require_unchanged(self) -> None:
        """Refuse photographs that changed since they were read: call it before a file is kept.

        Raises:
            InputError: a photograph changed.
        """
        require_unchanged(self.files, list(self.digests.values()))
