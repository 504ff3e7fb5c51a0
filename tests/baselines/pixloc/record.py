"""Record what the authors' code says: ``python -m tests.baselines.pixloc.record CHECKOUT``.

CHECKOUT is github.com/cvg/pixloc at commit 65a51a7; omegaconf and tqdm must be importable.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch

from tests.baselines.pixloc import official


def main() -> None:
    """Write ``official.RECORDED``."""
    official.load(Path(sys.argv[1]))
    found = {}
    for extra in (0, 1):
        extractor = official.refiner(extra).extractor
        for height, width in official.SIZES:
            with torch.no_grad():
                said = extractor({"image": official.picture(height, width)})
            for kind in ("feature_maps", "confidences"):
                for level, values in enumerate(said[kind][::-1]):
                    name = f"vgg{16 + 3 * extra}/{height}x{width}/{kind}/{level}"
                    found[name] = official.sampled(values)
                    found[f"{name}/shape"] = np.array(values.shape)
    official.RECORDED.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(official.RECORDED, **found)


if __name__ == "__main__":
    main()
