"""Speed of the network in other engines against torch: ``python -m experiments.engines``.

Needs ``pip install onnx onnxruntime openvino``. Prints, for each engine and number format, the
milliseconds of a pass over square pictures and the growth of the process's memory:

- 512, 720: pictures of one size, median of several passes;
- any: 24 sizes between these, once each, like photographs that are rotated north up.

Torch runs as in the localizer, but without ``shown``, which skips empty parts of a picture. The
integers of the other engines come from ONNX Runtime's own quantization with scales of random
pictures, so that they show the cost of a pass and not its accuracy.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from objconnect.learning.inference import fuse_layers
from objconnect.learning.quantization import largest_values, quantize
from objconnect.learning.vgg import encode
from objconnect.network.localizer import SHIPPED
from objconnect.network.network import ObjConnectNet, read_network
from objconnect.scene.runtime.memory import resident_bytes
from objconnect.scene.runtime.tuning import ProcessTuning

Pass = Callable[[NDArray[np.float32]], object]

ENGINES: Final = {
    "torch": ("float32", "bfloat16", "integers"),
    "onnxruntime": ("float32", "integers"),
    "openvino": ("float32", "bfloat16", "integers"),
}
# Sides of the pictures (px), passes per side, and number of sizes between.
_SIDES: Final = (512, 720)
_REPEATS: Final = 9
_SIZES: Final = 24


class ExportableNet(nn.Module):
    """The network without parts that engines do not support: tiled and on-demand maps."""

    def __init__(self, network: ObjConnectNet) -> None:
        super().__init__()
        self.network = network

    def forward(self, image: Tensor) -> list[Tensor]:
        """Return features and confidences of each level, coarse to fine."""
        network, outputs = self.network, list[Tensor]()
        strides = network.config.strides
        *skips, maps = encode(network.encoder, image, strides[-1])
        steps = [None, *network.decoder.children()]
        for number, step in enumerate(steps):
            if step is not None:
                up = functional.interpolate(maps, scale_factor=2.0, mode="bilinear")
                maps = step(torch.cat([up, skips.pop()], 1))
            # The encoder's last stride is 16; each step of the decoder halves it.
            if (stride := 16 >> number) in strides:
                level = strides.index(stride)
                outputs += [network.features[level](maps), network.confidence[level](maps).neg()]
        return outputs


def torch_pass(number_format: str) -> Pass:
    """Return a pass of the network as the localizer runs it."""
    network, _ = read_network(SHIPPED)
    fuse_layers(network, "float32" if number_format == "float32" else "bfloat16")
    if number_format == "integers":
        with torch.inference_mode(), torch.autocast("cpu"), largest_values(network) as largest:
            network(torch.rand(1, 3, 256, 256))
        scales = {name: values.clamp(min=1e-3) / 255 for name, values in largest.items()}
        network = quantize(network, scales, network.config.strides)

    @torch.inference_mode()
    def run(picture: NDArray[np.float32]) -> object:
        image = torch.from_numpy(picture).contiguous(memory_format=torch.channels_last)
        with torch.autocast("cpu", enabled=number_format != "float32"):
            return network(image)

    return run


def engine_pass(engine: str, number_format: str, threads: int, folder: Path) -> Pass:
    """Return a pass of the exported network in an engine."""
    file = folder / "network.onnx"
    network, _ = read_network(SHIPPED)
    axes = {"image": {2: "height", 3: "width"}}
    example = (torch.rand(1, 3, 256, 256),)
    torch.onnx.export(
        ExportableNet(network),
        example,
        file,
        input_names=["image"],
        dynamic_axes=axes,
        dynamo=False,
    )
    if number_format == "integers":
        file = _quantize(file)
    if engine == "openvino":
        import openvino

        settings = {
            "INFERENCE_PRECISION_HINT": "f32" if number_format == "float32" else "bf16",
            "INFERENCE_NUM_THREADS": threads,
            "PERFORMANCE_HINT": "LATENCY",
        }
        request = openvino.Core().compile_model(file, "CPU", settings).create_infer_request()
        return lambda picture: request.infer({0: picture}, share_inputs=True, share_outputs=True)
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
    return lambda picture: session.run(None, {"image": picture})


def _quantize(file: Path) -> Path:
    """Quantize an exported network by the values that it has in two random pictures."""
    from onnxruntime import quantization as onnx

    pictures = [{"image": _picture(256)} for _ in range(2)]

    class Reader(onnx.CalibrationDataReader):  # type: ignore[misc]
        def get_next(self) -> dict[str, Any] | None:
            return pictures.pop() if pictures else None

    target = file.with_name("integers.onnx")
    types = {"activation_type": onnx.QuantType.QUInt8, "weight_type": onnx.QuantType.QInt8}
    onnx.quantize_static(file, target, Reader(), per_channel=True, **types)
    return target


def _picture(side: int) -> NDArray[np.float32]:
    return np.random.default_rng(side).random((1, 3, side, side), dtype=np.float32)


def measure(run: Pass) -> list[float]:
    """Return milliseconds of a pass of 512 and of 720 pixels, and of any size between."""
    sizes = np.random.default_rng(0).uniform(*_SIDES, _SIZES).astype(int) // 16 * 16

    def seconds(picture: NDArray[np.float32]) -> float:
        begin = perf_counter()
        run(picture)
        return perf_counter() - begin

    fixed = [median([seconds(_picture(side)) for _ in range(_REPEATS)]) for side in _SIDES]
    each_once = [seconds(_picture(int(side))) for side in sizes]
    return [1e3 * each for each in (*fixed, sum(each_once) / _SIZES)]


def main() -> None:
    """Measure each engine in its own process."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--one", nargs=2, metavar=("ENGINE", "NUMBERS"))
    args = parser.parse_args()
    if args.one is None:
        print(f"{'':24} {'512':>6} {'720':>6} {'any':>6} ms {'held':>6} MB")
        for engine, formats in ENGINES.items():
            for number_format in formats:
                arguments = ["--threads", str(args.threads), "--one", engine, number_format]
                subprocess.run([sys.executable, "-m", __spec__.name, *arguments], check=True)
        return
    torch.set_num_threads(args.threads)
    engine, number_format = args.one
    before = resident_bytes()
    with tempfile.TemporaryDirectory() as folder:
        if engine == "torch":
            run = torch_pass(number_format)
        else:
            run = engine_pass(engine, number_format, args.threads, Path(folder))
        cost = measure(run)
        growth_mb = (resident_bytes() - before) / 1e6
    print(
        f"{engine + ' ' + number_format:24}",
        *(f"{each:6.1f}" for each in cost),
        f"   {growth_mb:6.0f}",
    )


if __name__ == "__main__":
    with ProcessTuning():  # as the command line
        main()
