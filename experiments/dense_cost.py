"""Cost and errors of depth maps, for some photographs of a rendered scene.

``python -m experiments.dense_cost SCENE`` (a finished scene with a map and rendered depth).
To measure another version of the code: ``PYTHONPATH=FOLDER python -P THIS_FILE SCENE``.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.mapping.dense.consistency import count_agreeing
from objconnect.mapping.dense.patchmatch import consistent_estimate, first_estimate
from objconnect.mapping.dense.report import read_truth
from objconnect.mapping.dense.sources import choose_all, find_seeds
from objconnect.mapping.dense.undistort import pinhole_of, undistort_map, write_undistorted
from objconnect.mapping.dense.warp import StereoView
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.sparse_map import MapImage
from objconnect.scene.storage.images import read_rgb

# Longest side of a depth map (px), and its maximum number of sources.
_SIZE = 512
_SOURCES = 6
# Minimum number of sources that confirm a depth.
_CONFIRMED = 2


@torch.inference_mode()
def main() -> None:
    """Print one line per photograph, and one for all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--every", type=int, default=12, help="take every n-th photograph")
    args = parser.parse_args()
    torch.set_num_threads(1)
    scene = Scene.open(args.scene)
    original = scene.sparse_map()
    cameras = {image.camera: pinhole_of(image.camera, _SIZE) for image in original.images.values()}
    sparse_map = undistort_map(original, cameras)
    truth = read_truth(scene, sparse_map)
    sources_of = choose_all(sparse_map, _SOURCES, _CONFIRMED)
    views = {
        name: _view(scene.images_root / name, image, cameras[image.camera])
        for name, image in original.images.items()
    }
    first: dict[str, torch.Tensor] = {}
    seconds: dict[str, float] = {}

    def estimate_alone(name: str) -> torch.Tensor:
        """Return the planes of a photograph by itself, computed once."""
        if name not in first:
            sources = [views[other] for other in sources_of[name]]
            began = time.process_time()
            generator = torch.Generator().manual_seed(0)
            seeds = find_seeds(sparse_map, name)
            first[name] = first_estimate(views[name], sources, seeds, generator).planes
            seconds[name] = time.process_time() - began
        return first[name]

    costs: list[tuple[float, float]] = []
    errors: list[NDArray[np.float64]] = []
    for name in list(sources_of)[args.every // 2 :: args.every]:
        sources = [views[other] for other in sources_of[name]]
        planes, inverse = (
            estimate_alone(name),
            [estimate_alone(other)[0] for other in sources_of[name]],
        )
        began = time.process_time()
        generator = torch.Generator().manual_seed(0)
        last = consistent_estimate(views[name], sources, planes, inverse, generator).planes[0]
        confirmed = count_agreeing(views[name], sources, last, inverse) >= _CONFIRMED
        costs.append((seconds[name], time.process_time() - began))
        error = np.where(confirmed, np.abs(1 / last.numpy() / truth[name].depth - 1), np.inf)
        errors.append(error[truth[name].evaluable])
        print(f"{name}: {_summary(costs[-1:], errors[-1:])}")
    print(f"all: {_summary(costs, errors)}")


def _view(photograph: Path, image: MapImage, pinhole: Camera) -> StereoView:
    """Return a photograph of the map without distortion."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "undistorted.jpg"
        write_undistorted(photograph, image.camera, pinhole, path)
        rgb = read_rgb(path, pinhole)
    grey = rgb.astype(np.float32).mean(-1) / 255
    return StereoView(torch.from_numpy(grey), pinhole, image.cam_from_world)


def _summary(costs: list[tuple[float, float]], errors: list[NDArray[np.float64]]) -> str:
    """Return a line with the cost and the errors of depth maps."""
    alone, compared = np.mean(costs, 0)
    all_errors = np.concatenate(errors)
    return (
        f"{alone:.2f} s by itself and {compared:.2f} s compared, "
        f"{np.isfinite(all_errors).mean():.1%} of pixels have a depth, "
        f"{np.mean(all_errors < 0.005):.1%} within 0.5 %, median error "
        f"{np.median(all_errors[np.isfinite(all_errors)]):.3%}"
    )


if __name__ == "__main__":
    main()
