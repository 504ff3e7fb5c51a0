"""Record what the authors' code says: ``python -m tests.baselines.pixloc.record CHECKOUT``.

CHECKOUT is github.com/cvg/pixloc at commit 65a51a7; omegaconf and tqdm must be importable.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch

from objconnect.scene.geometry.pose import Pose as OurPose
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
                    found[name] = official.sample(values)
                    found[f"{name}/shape"] = np.array(values.shape)
    found |= _pair()
    official.RECORDED.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(official.RECORDED, **found)


def _pair() -> dict[str, Any]:
    """Poses found between two pictures, and the loss of other poses."""
    from pixloc.pixlib.geometry import Camera, Pose  # type: ignore[import-not-found]

    def theirs(pose: OurPose) -> Any:
        return Pose.from_Rt(pose.rotation.float(), pose.translation.float())

    refiner, pair, size = official.refiner(), official.pair(), official.CAMERA
    fx, fy, cx, cy = size.params
    camera = Camera(torch.tensor([[size.width, size.height, fx, fy, cx - 0.5, cy - 0.5]]))
    identity = OurPose(torch.eye(3)[None], torch.zeros(1, 3))
    views = [{"image": image, "camera": camera} for image in pair.images]
    data = {
        "ref": views[0] | {"points3D": pair.points[None].float(), "T_w2cam": theirs(identity)},
        "query": views[1] | {"T_w2cam": theirs(identity)},
        "T_r2q_init": theirs(identity),
        "T_r2q_gt": theirs(OurPose(*(t[None] for t in vars(pair.query_from_reference).values()))),
    }
    with torch.no_grad():
        answer = refiner(data)
    found = {"pose": np.stack([t._data[0].numpy() for t in answer["T_r2q_opt"]])}

    start, after = official.poses_after_levels()
    count = len(start.rotation)
    points = pair.points.float().expand(count, -1, 3).clone()
    points[-1, 9:] = -1  # behind the camera
    data = {
        "ref": {"points3D": points},
        "query": {"camera": Camera(camera._data.expand(count, -1))},
        "T_r2q_init": theirs(start),
        "T_r2q_gt": Pose(data["T_r2q_gt"]._data.expand(count, -1)),
        "scene": ["ground"] * count,
    }
    data["ref"]["index"] = data["query"]["index"] = torch.arange(count)
    losses = refiner.loss({"T_r2q_init": [theirs(start)], "T_r2q_opt": [*map(theirs, after)]}, data)
    found["loss"] = losses["total"].numpy()
    found["errors"] = np.stack([losses[f"reprojection_error/{n}"].numpy() for n in range(3)])
    return found


if __name__ == "__main__":
    main()
