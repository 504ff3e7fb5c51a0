"""The authors' code on weights and pictures that ours can be given too, none of them stored.

    git clone https://github.com/mihaidusmanu/d2-net && git -C d2-net checkout 0a3356c
    python -m tests.baselines.d2net.official d2-net

writes ``RECORDED``. Their torchvision is only asked for VGG16's layers and is replaced by them.
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from objconnect.learning.vgg import BLOCKS, vgg16_blocks

RECORDED = Path(__file__).parents[2] / "data/official/d2net-0a3356c.npz"
# Of the pictures; the second is the same scene moved by SHIFT.
HEIGHT, WIDTH, SHIFT = 96, 128, 16
# Name, height, width and levels of what keypoints are found in: the first picture's corner.
DETECTED = (
    ("single", HEIGHT, WIDTH, (1.0,)),
    ("multi", HEIGHT, WIDTH, (0.5, 1.0, 2.0)),
    ("odd", 93, 125, (0.5, 1.0, 2.0)),
)
# Every so many channels of the descriptors are kept.
CHANNELS = 16
_SAMPLES = 64


def tensors() -> dict[str, Tensor]:
    """Weights as in the authors' checkpoints, of He's scale, from NumPy's PCG64 and the seed 0.

    Those of the first layer are 60 times smaller, which keeps the activations of pictures in
    0..255 near one.
    """
    rng = np.random.Generator(np.random.PCG64(0))
    found: dict[str, Tensor] = {}
    inputs, index = 3, 0
    for sizes in BLOCKS[:4]:
        for size in sizes:
            name = f"dense_feature_extraction.model.{index}"
            scale = np.sqrt(2 / (9 * inputs)) / (60 if index == 0 else 1)
            weight = rng.standard_normal((size, inputs, 3, 3), np.float32)
            found[f"{name}.weight"] = torch.from_numpy(weight * np.float32(scale))
            bias = rng.standard_normal(size, np.float32)
            found[f"{name}.bias"] = torch.from_numpy(bias * np.float32(0.1))
            inputs, index = size, index + 2
        index += 1
    return found


def pictures() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Two views of squares under noise, (HEIGHT, WIDTH, 3), from the seed 1."""
    rng = np.random.Generator(np.random.PCG64(1))
    size = (HEIGHT, WIDTH + SHIFT, 3)
    squares = rng.integers(0, 256, (size[0] // 8, size[1] // 8, 3)).repeat(8, 0).repeat(8, 1)
    scene = ((3 * squares + rng.integers(0, 256, size)) // 4).astype(np.uint8)
    return scene[:, :WIDTH], scene[:, SHIFT:]


def sample(values: Tensor) -> NDArray[np.float32]:
    """Mean, standard deviation and evenly spaced values of a tensor."""
    flat = values.detach().double().flatten().numpy()
    rows = np.linspace(0, len(flat) - 1, _SAMPLES).astype(int)
    return np.concatenate([[flat.mean(), flat.std()], flat[rows]]).astype(np.float32)


def load(checkout: Path) -> None:
    """Make the authors' package ``lib`` importable."""
    torchvision, models = ModuleType("torchvision"), ModuleType("torchvision.models")
    models.vgg16 = _Vgg  # type: ignore[attr-defined]
    torchvision.models = models  # type: ignore[attr-defined]
    sys.modules |= {"torchvision": torchvision, "torchvision.models": models}
    sys.path.insert(0, str(checkout))


class _Vgg(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.features = nn.Sequential(*(m for b in vgg16_blocks() for m in (*b, nn.MaxPool2d(2))))


def record(out: Path) -> None:
    """Run the authors' code and keep what comes out."""
    from lib import loss, model, model_test, pyramid, utils  # type: ignore[import-not-found]

    inputs = [
        torch.from_numpy(utils.preprocess_image(picture, "caffe").astype(np.float32))[None]
        for picture in pictures()
    ]
    kept: dict[str, Any] = {}
    used = model_test.D2Net(use_cuda=False).eval()
    used.load_state_dict(tensors())
    with torch.no_grad():
        kept["dense"] = sample(used.dense_feature_extraction(inputs[0]))
        for name, height, width, scales in DETECTED:
            yx, scores, descriptors = pyramid.process_multiscale(
                inputs[0][:, :, :height, :width], used, list(scales)
            )
            kept |= {
                f"{name}_yx": yx.astype(np.float32),
                f"{name}_scores": scores.astype(np.float32),
                f"{name}_descriptors": descriptors[:, ::CHANNELS].astype(np.float32),
            }
    trained = model.D2Net(use_cuda=False)
    trained.load_state_dict(tensors())
    features = trained.dense_feature_extraction(inputs[0])
    kept |= {"trained": sample(features), "soft": trained.detection(features).detach()[0]}
    # A plane eight metres away, and a step of one metre to the right: SHIFT pixels.
    lens = torch.tensor([[128.0, 0, WIDTH / 2], [0, 128, HEIGHT / 2], [0, 0, 1]])
    moved = torch.eye(4)
    moved[0, 3] = -SHIFT * 8 / 128
    batch = {"image1": inputs[0], "image2": inputs[1]}
    for number, pose in ((1, torch.eye(4)), (2, moved)):
        batch |= {
            f"depth{number}": torch.full((1, HEIGHT, WIDTH), 8.0),
            f"intrinsics{number}": lens[None],
            f"pose{number}": pose[None],
            f"bbox{number}": torch.zeros(1, 2),
        }
    value = loss.loss_function(trained, batch, torch.device("cpu"))
    value.backward()
    last = trained.dense_feature_extraction.model[-1]
    kept |= {"loss": value.item(), "gradient": sample(last.weight.grad)}
    out.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(out, **kept)


if __name__ == "__main__":
    load(Path(sys.argv[1]))
    record(RECORDED)
