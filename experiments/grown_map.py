"""Cost of preparing a map with added photographs, with and without the old map's cache.

``python -m experiments.grown_map OLD NEW`` takes a scene and the scene that ``objconnect ingest
PHOTOS --add OLD --out NEW`` made from it. It prepares OLD, then NEW with the same cache, then NEW
with an empty one, which must give the same features.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import h5py
import numpy as np

from objconnect.localization.cache.store import Store
from objconnect.methods import create
from objconnect.scene.bundle.scene import Scene


def main() -> None:
    """Print the seconds of the three preparations, and the number of photographs from the cache."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("--method", default="objconnect")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        caches = Path(scratch) / "kept", Path(scratch) / "alone"
        old, old_seconds = _prepare(args.old, args.method, caches[0])
        new, grown = _prepare(args.new, args.method, caches[0])
        _, alone = _prepare(args.new, args.method, caches[1])
        # The names of the files end in 16 digits of a digest and ".h5".
        (fresh,) = caches[1].glob(f"{args.method}-*.h5")
        (before,) = set(caches[0].glob(fresh.name[:-19] + "*.h5")) - {caches[0] / fresh.name}
        _require_same(fresh, caches[0] / fresh.name)
        copied = len(Store(fresh).rows.keys() & Store(before).rows.keys())
    print(f"{args.method}: {old} photographs in {old_seconds:.1f} s")
    print(f"{new} photographs in {alone:.1f} s, after these in {grown:.1f} s", end="")
    print(f" ({grown / alone:.2f}); features of {copied} were copied")


def _prepare(path: Path, method: str, cache: Path) -> tuple[int, float]:
    """Prepare a map; return its number of photographs and the processor seconds."""
    scene = Scene.open(path)
    sparse_map, localizer = scene.sparse_map(), create(method, {})
    begin = time.process_time()
    localizer.prepare(sparse_map, scene.images_root, cache)
    return len(sparse_map.names), time.process_time() - begin


def _require_same(one: Path, other: Path) -> None:
    """Compare all arrays of two HDF5 files."""
    with h5py.File(one) as a, h5py.File(other) as b:

        def compare(name: str, node: Any) -> None:
            if isinstance(node, h5py.Dataset):
                np.testing.assert_array_equal(node[...], b[name][...], name)

        a.visititems(compare)


if __name__ == "__main__":
    main()
