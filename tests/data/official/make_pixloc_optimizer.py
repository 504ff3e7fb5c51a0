"""Records where PixLoc's own optimizer goes, for the test of the aligner.

    python -m tests.data.official.make_pixloc_optimizer CLONE

with CLONE a checkout of github.com/cvg/pixloc at 65a51a7, and omegaconf installed.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch

from tests.objconnect.localization.align.official import CASES, ITERATIONS, RECORD, case


def main(clone: str) -> None:
    """Write the record."""
    sys.path.insert(0, clone)
    from pixloc.pixlib.geometry import Camera, Pose
    from pixloc.pixlib.models.learned_optimizer import LearnedOptimizer

    record = {}
    for name in CASES:
        at = case(name)
        camera = Camera.from_colmap(
            {
                "model": at.camera.model,
                "width": at.camera.width,
                "height": at.camera.height,
                "params": np.array(at.camera.params),
            }
        )
        for count in ITERATIONS:
            pose = Pose.from_Rt(at.start.rotation[None].float(), at.start.translation[None].float())
            for level, theta in zip(at.levels, at.thetas, strict=True):
                optimizer = LearnedOptimizer(
                    {"num_iters": count, "loss_fn": "scaled_barron(0, 0.1)"}
                ).train()
                # Theirs is translation then rotation.
                optimizer.dampingnet.const.data = torch.cat([theta[3:], theta[:3]])
                trust = None
                if level.confidence is not None:
                    trust = (level.reference_confidence[..., None], level.confidence)
                scale = 1 / level.stride
                pose, failed = optimizer._run(
                    at.points.float()[None],
                    level.reference,
                    level.features,
                    pose,
                    Camera(camera.scale(scale)._data.float()[None]),
                    W_ref_query=trust,
                )
                assert not failed.any()
                pose = pose.detach()
            record[f"{name}/{count}/R"] = pose.R[0].numpy()
            record[f"{name}/{count}/t"] = pose.t[0].numpy()
    np.savez_compressed(RECORD, **record)


if __name__ == "__main__":
    main(str(Path(sys.argv[1]).resolve()))
