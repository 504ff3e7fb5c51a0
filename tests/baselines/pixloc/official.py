"""The authors' code beside ours: the same weights and pictures for both, none of them stored."""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from objconnect.learning.pixloc_net import PixlocNet, read_network
from objconnect.learning.vgg import BLOCKS, vgg16_blocks
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose

RECORDED = Path(__file__).parents[2] / "data/official/pixloc-65a51a7-network.npz"
# Whole, odd, and with sides whose rest of 16 is cut off at several levels.
SIZES = ((64, 96), (77, 109), (127, 70))
SAMPLES = 64


def shapes(extra: int = 0) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the tensors in the authors' checkpoint, VGG16 or (``extra`` 1) VGG19."""
    found: dict[str, tuple[int, ...]] = {}

    def conv(name: str, inputs: int, outputs: int, size: int, bias: bool = True) -> None:
        found[f"{name}.weight"] = (outputs, inputs, size, size)
        if bias:
            found[f"{name}.bias"] = (outputs,)

    before = 3
    for block, sizes in enumerate(BLOCKS):
        more = extra if block >= 2 else 0
        for position, size in enumerate((*sizes, *sizes[:1] * more)):
            conv(f"extractor.encoder.{block}.{2 * position + (block > 0)}", before, size, 3)
            before = size
    for step, (skip, size) in enumerate(((512, 64), (256, 64), (128, 64), (64, 32))):
        name = f"extractor.decoder.{step}.layers"
        conv(f"{name}.0", before + skip, size, 3, bias=False)
        for part in ("weight", "bias", "running_mean", "running_var"):
            found[f"{name}.1.{part}"] = (size,)
        found[f"{name}.1.num_batches_tracked"] = ()
        before = size
    for level, (size, dim) in enumerate(((32, 32), (64, 128), (512, 128))):
        conv(f"extractor.adaptation.{level}.0", size, dim, 1)
        conv(f"extractor.uncertainty.{level}.0", size, 1, 1)
        found[f"optimizer.{level}.dampingnet.const"] = (6,)
    return found


@cache
def tensors(extra: int = 0) -> dict[str, Tensor]:
    """Weights as in the authors' checkpoint, from NumPy's PCG64: He's scale, no trained ones."""
    rng = np.random.Generator(np.random.PCG64(0))
    made: dict[str, Tensor] = {}
    for name, shape in shapes(extra).items():
        normal = rng.standard_normal(shape, np.float32)
        if name.endswith("num_batches_tracked"):
            made[name] = torch.tensor(1)
        elif name.endswith("running_var"):
            made[name] = torch.from_numpy(np.asarray(1 + 0.25 * np.tanh(normal)))
        elif name.endswith(".1.weight") and len(shape) == 1:
            made[name] = torch.from_numpy(1 + 0.1 * normal)
        elif len(shape) == 4:
            scale = np.float32(np.sqrt(2 / np.prod(shape[1:])))
            made[name] = torch.from_numpy(scale * normal)
        else:
            made[name] = torch.from_numpy(np.float32(0.1) * normal)
    return made


def ours(extra: int = 0) -> PixlocNet:
    """Our network with these weights, by the way of a checkpoint file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "checkpoint_best.tar"
        torch.save(
            {
                "model": tensors(extra),
                "conf": {"model": {"name": "two_view_refiner"}},
                "eval": {"loss/reprojection_error_median": np.float64(1.5)},
            },
            path,
        )
        return read_network(path)[0]


def picture(height: int, width: int) -> Tensor:
    """A smooth picture in 0..1, (1, 3, H, W)."""
    y, x = np.mgrid[:height, :width]
    waves = [np.sin(x / 7 + c) * np.cos(y / (5 + c)) + np.sin((x + 2 * y) / 23) for c in range(3)]
    return torch.from_numpy((np.stack(waves)[None] / 4 + 0.5).astype(np.float32))


CAMERA = Camera("PINHOLE", 256, 192, (220.0, 224.0, 126.0, 98.0))


@dataclass(frozen=True)
class Pair:
    """Two pictures of smooth ground 20 m below, and points of it.

    Attributes:
        images: (1, 3, H, W) of the reference and of the query.
        points: (N, 3) in the reference's camera.
        query_from_reference: the truth.
    """

    images: tuple[Tensor, Tensor]
    points: Tensor
    query_from_reference: Pose


def pair() -> Pair:
    """Moved by 0.6 m and turned by two degrees."""
    tangent = torch.tensor([0.02, -0.02, 0.03, 0.4, -0.3, 0.3], dtype=torch.float64)
    truth = Pose.exp(tangent)
    views = []
    for pose in (Pose.identity(), truth):
        rays, _ = CAMERA.unproject(CAMERA.pixel_grid().flatten(0, 1))
        back = pose.inverse()
        rays = rays @ back.rotation.T
        ground = back.translation + rays * ((20 - back.translation[2]) / rays[:, 2:])
        x, y = ground[:, 0].numpy(), ground[:, 1].numpy()
        waves = [
            np.sin(1.3 * x + c) * np.cos((1.1 + 0.2 * c) * y) + np.sin(0.6 * x - 0.9 * y + c)
            for c in range(3)
        ]
        shades = np.stack(waves).reshape(1, 3, CAMERA.height, CAMERA.width) / 4 + 0.5
        views.append(torch.from_numpy(shades.astype(np.float32)))
    x, y = np.meshgrid(np.linspace(-9, 9, 16), np.linspace(-7, 7, 12))
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, 20.0)], -1)
    return Pair((views[0], views[1]), torch.from_numpy(points), truth)


def poses_after_levels() -> tuple[Pose, list[Pose]]:
    """What five alignments of ``pair`` might have been after three levels, and their starts: good
    and bad ones. Each batched (5)."""
    rng = np.random.default_rng(1)
    directions = torch.from_numpy(rng.standard_normal((5, 6)) * [[0.02] * 3 + [0.4] * 3])
    truth = pair().query_from_reference

    def off(*sizes: float) -> Pose:
        return Pose.exp(directions * torch.tensor(sizes)[:, None]) @ truth

    after = [off(0.2, 3, 1, 9, 0.5), off(0.05, 1, 4, 1, 0.5), off(0.01, 1, 0.1, 0.1, 0.5)]
    return off(1, 1, 1, 1, 1), after


def sample(values: Tensor) -> NDArray[np.float32]:
    """Mean, standard deviation and evenly spaced values of a tensor."""
    flat = values.detach().double().flatten().numpy()
    rows = np.linspace(0, len(flat) - 1, SAMPLES).astype(int)
    return np.concatenate([[flat.mean(), flat.std()], flat[rows]]).astype(np.float32)


def load(checkout: Path) -> None:
    """Make the authors' package ``pixloc`` importable; it needs omegaconf and tqdm.

    torchvision is only asked for VGG's layers and is replaced by them; ``torch._six`` has gone from
    PyTorch since.
    """
    six: Any = ModuleType("torch._six")
    six.string_classes = (str, bytes)
    sys.modules["torch._six"] = six
    if "torchvision" not in sys.modules:
        torchvision = ModuleType("torchvision")
        models: Any = ModuleType("torchvision.models")
        models.vgg16 = lambda pretrained: _Vgg(0)
        models.vgg19 = lambda pretrained: _Vgg(1)
        sys.modules["torchvision"] = torchvision
        sys.modules["torchvision.models"] = models
        torchvision.models = models  # type: ignore[attr-defined]
    sys.path.insert(0, str(checkout))


class _Vgg(nn.Module):
    def __init__(self, extra: int) -> None:
        super().__init__()
        blocks = vgg16_blocks(extra=extra)
        self.features = nn.Sequential(*(m for b in blocks for m in (*b, nn.MaxPool2d(2))))


def refiner(extra: int = 0, **optimizer: Any) -> Any:
    """The authors' network and optimizer with the weights of ``tensors``."""
    from pixloc.pixlib.models.two_view_refiner import (  # type: ignore[import-not-found]
        TwoViewRefiner,
    )

    model = TwoViewRefiner(
        {
            "name": "two_view_refiner",
            "success_thresh": 3,
            "normalize_features": True,
            "duplicate_optimizer_per_scale": True,
            "normalize_dt": False,
            "extractor": {
                "name": "unet",
                "encoder": "vgg19" if extra else "vgg16",
                "decoder": [64, 64, 64, 32],
                "output_scales": [0, 2, 4],
                "output_dim": [32, 128, 128],
                "compute_uncertainty": True,
            },
            "optimizer": {
                "name": "learned_optimizer",
                "num_iters": 15,
                "pad": 3,
                "lambda_": 0.01,
                "loss_fn": "scaled_barron(0, 0.1)",
                "jacobi_scaling": False,
                "learned_damping": True,
                # All iterations, whatever the steps.
                "dt_stop_criteria": 0.0,
                "grad_stop_criteria": 0.0,
                "damping": {"type": "constant"},
            }
            | optimizer,
        }
    )
    model.load_state_dict(tensors(extra), strict=True)
    return model.eval()
