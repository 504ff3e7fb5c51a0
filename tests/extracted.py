"""SIFT features of pictures that many tests extract, which are the same in every test."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from objconnect.scene.colmap import database, sift
from objconnect.scene.colmap.options import SiftOptions
from objconnect.scene.colmap.sift import SiftExtractor
from objconnect.scene.maps.features import Features

Key = tuple[str, bytes]


@contextmanager
def remember_features() -> Iterator[None]:
    """Extract the features of a picture once, by ``SiftExtractor`` and by ``extract_sift``."""
    extract, extract_all = SiftExtractor.__call__, sift.extract_sift

    def remembered(extractor: SiftExtractor, rgb: NDArray[np.uint8]) -> Features:
        key = (str(extractor._options.todict()), hashlib.sha256(rgb.tobytes()).digest())
        if key not in _OF_PIXELS:
            _OF_PIXELS[key] = extract(extractor, rgb)
        return _OF_PIXELS[key]

    def all_remembered(
        root: Path, names: Sequence[str], options: SiftOptions, *rest: Any, **more: Any
    ) -> dict[str, Features]:
        files = {name: root / name for name in names if (root / name).is_file()}
        keys = {name: _key(options, file) for name, file in files.items()}
        new = [name for name in names if keys.get(name) not in _OF_FILES]
        if new:
            found = extract_all(root, new, options, *rest, **more)
            _OF_FILES.update({keys[name]: features for name, features in found.items()})
        return {name: _OF_FILES[keys[name]] for name in names}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SiftExtractor, "__call__", remembered)
        for module in (sift, database):
            patch.setattr(module, "extract_sift", all_remembered)
        yield


_OF_PIXELS: dict[Key, Features] = {}
_OF_FILES: dict[Key, Features] = {}


def _key(options: SiftOptions, file: Path) -> Key:
    return repr(options), hashlib.sha256(file.read_bytes()).digest()
