"""Processor seconds of a training step, against the code of PixLoc's authors.

``python -m experiments.training_step CHECKOUT`` trains each method for a few steps on one pair of
pictures of smooth ground, in its own process with one thread. CHECKOUT is
github.com/cvg/pixloc at commit 65a51a7; omegaconf and tqdm must be importable. The methods:

- objconnect, pixloc: as shipped, at a quarter of VGG16's width, features and poses together;
- full: pixloc at the authors' width;
- authors: their network, alignment, loss and optimizer, as their configuration for CMU sets them,
  but without the checkpoints that save memory and cost time.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable
from itertools import product
from pathlib import Path
from time import process_time
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor, nn

from baselines.pixloc.training import PixlocTraining
from objconnect.learning.training.config import TrainConfig
from objconnect.learning.training.loop import Trainable
from objconnect.learning.training.pairs import Pair, PairBatch, Pinhole, collate
from objconnect.network.training import ObjConnectTraining
from objconnect.scene.config import load_config
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from tests.baselines.pixloc import official

METHODS: Final = ("objconnect", "pixloc", "full", "authors")
# Sides of the pictures (px), measured steps, and points of a pair.
_SIDES: Final = (192, 512)
_STEPS: Final = 3
_POINTS: Final = 512
# The authors' configuration for CMU: learning rates of the network and of the damping, and maximum
# norm of the gradient.
_RATE, _DAMPING_RATE, _CLIP = 1e-5, 1e-3, 1.0


def pair(side: int) -> Pair:
    """Return one pair of pictures (side x side) of ground 20 m below, moved by 0.6 m."""
    truth = Pose.exp(torch.tensor([0.02, -0.02, 0.03, 0.4, -0.3, 0.3], dtype=torch.float64))
    camera = Camera("PINHOLE", side, side, (0.9 * side, 0.9 * side, side / 2, side / 2))
    xy = np.random.default_rng(0).uniform(0.2 * side, 0.8 * side, (_POINTS, 2))
    rays, _ = camera.unproject(torch.from_numpy(xy))
    points = 20 * rays / rays[:, 2:]
    picture = (255 * official.picture(side, side)[0].permute(1, 2, 0).clamp(0, 1)).byte().numpy()
    pinhole = Pinhole(np.array(camera.params[:2]), np.array(camera.params[2:]))
    return Pair(
        image_a=picture,
        image_b=np.roll(picture, 3, 1),
        camera_a=pinhole,
        camera_b=pinhole,
        b_from_a=truth.matrix().numpy(),
        start=np.eye(4),
        points=points.numpy(),
        xy_a=xy,
        xy_b=camera.project(truth.transform(points)).xy.numpy(),
        valid=np.ones(_POINTS, dtype=bool),
    )


def make(method: str, side: int) -> Callable[[], object]:
    """Return a function that takes one step of a method."""
    batch = collate([pair(side)])
    if method == "authors":
        return _authors(batch)
    if method == "objconnect":
        trained: Trainable = ObjConnectTraining(
            load_config(TrainConfig, Path("train/objconnect"), {})
        )
    else:
        network = {"strides": (16, 4, 1)} if method == "full" else {}
        width = 1.0 if method == "full" else 0.25
        trained = PixlocTraining(TrainConfig(warm_up=0, width=width, network=network))
    network = trained.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimizer = torch.optim.AdamW(trained.groups(1e-3))
    network.train()

    def step() -> object:
        loss, _ = trained.loss(batch, 1.0)
        return _descend(loss, network, optimizer)

    return step


def _authors(batch: PairBatch) -> Callable[[], object]:
    """Return a step of the authors' training, as their ``train.py`` takes it."""
    from pixloc.pixlib.geometry import Camera as Lens  # type: ignore[import-not-found]
    from pixloc.pixlib.geometry import Pose as Stance

    def convert(pose: Pose) -> Any:
        return Stance.from_Rt(pose.rotation, pose.translation)

    model = official.refiner()
    side = batch.image_a.shape[-1]
    focal, principal = batch.intrinsics_a.focal, batch.intrinsics_a.principal
    size = torch.full((1, 2), float(side))
    camera = Lens(torch.cat([size, focal, principal - 0.5], -1))
    start = convert(batch.start)
    shared = {"camera": camera, "T_w2cam": start}
    data = {
        "ref": shared | {"image": batch.image_a, "points3D": batch.points},
        "query": shared | {"image": batch.image_b, "T_w2cam": convert(batch.b_from_a)},
        "T_r2q_init": start,
        "T_r2q_gt": convert(batch.b_from_a),
    }
    damping = [p for name, p in model.named_parameters() if "dampingnet" in name]
    others = [p for name, p in model.named_parameters() if "dampingnet" not in name]
    optimizer = torch.optim.Adam(
        [{"params": others, "lr": _RATE}, {"params": damping, "lr": _DAMPING_RATE}]
    )
    model.train()

    def step() -> object:
        losses = model.loss(model(data), data)
        return _descend(losses["total"].mean(), model, optimizer)

    return step


def _descend(loss: Tensor, network: nn.Module, optimizer: torch.optim.Optimizer) -> float:
    loss.backward()  # type: ignore[no-untyped-call]
    norm = nn.utils.clip_grad_norm_(network.parameters(), _CLIP)
    assert torch.isfinite(norm) and float(norm) > 0
    optimizer.step()
    optimizer.zero_grad()
    return float(loss.detach())


def _measure(args: argparse.Namespace) -> None:
    """Print processor seconds of a step as a line of JSON, in its own process."""
    torch.set_num_threads(1)
    official.load(args.checkout)
    step = make(args.one, args.side)
    step()
    spent = []
    for _ in range(_STEPS):
        began = process_time()
        step()
        spent.append(process_time() - began)
    print(json.dumps(float(np.median(spent))))


def main() -> None:
    """Measure all methods and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("checkout", type=Path)
    parser.add_argument("--one", choices=METHODS, help=argparse.SUPPRESS)
    parser.add_argument("--side", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        _measure(args)
        return
    seconds: dict[tuple[str, int], float] = {}
    for side, method in product(_SIDES, METHODS):
        command = [sys.executable, "-m", "experiments.training_step", str(args.checkout)]
        command += ["--one", method, "--side", str(side)]
        environment = os.environ | {"OMP_NUM_THREADS": "1"}
        done = subprocess.run(
            command, stdout=subprocess.PIPE, text=True, check=True, env=environment
        )
        seconds[method, side] = json.loads(done.stdout.splitlines()[-1])
    print("method      side  processor s  of the authors'")
    for (method, side), spent in seconds.items():
        print(f"{method:12s}{side:4d}{spent:13.2f}{spent / seconds['authors', side]:17.3f}")


if __name__ == "__main__":
    main()
