"""Files of weights: safetensors, and torch checkpoints, from which only tensors are read."""

from __future__ import annotations

import json
import re
from argparse import Namespace
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from objconnect.learning.weights_file import find_weights
from objconnect.scene.errors import InputError
from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.files import parse_json


def shipped_path(path: Path) -> Path:
    """Return ``path``, the file of shipped weights, if it exists.

    Raises:
        InputError: the file does not exist.
    """
    if not path.is_file():
        raise InputError(
            f"no weights at {path}: train them (objconnect train {path.stem}), or give a file with "
            "weights=FILE"
        )
    return path


class _Number:
    """A placeholder for NumPy's numbers and types in checkpoints, where training scripts store
    scores.

    NumPy's own types accept any state from a file and crash on a damaged file.
    """

    def __init__(self, *_: object) -> None:
        """Ignore the values of the file, which are not used."""

    def __setstate__(self, _: object) -> None:
        """Ignore the state of the file, which is not used."""


# Types that checkpoints may contain in addition to tensors: arguments and scores of training
# scripts. A score is stored as a call of a NumPy function, whose name differs between versions.
_ALLOWED_TYPES: Final[list[Any]] = [
    (_Number, "numpy.core.multiarray.scalar"),
    (_Number, "numpy._core.multiarray.scalar"),
    (_Number, "numpy.dtype"),
    Namespace,
]


@dataclass(frozen=True)
class Weights:
    """Tensors by name, with the configuration of their network.

    Attributes:
        tensors: tensors by the names of the network's ``state_dict``.
        config: configuration of the network; empty if the file has none.
        sha256: digest of the file.
    """

    tensors: dict[str, Tensor]
    config: dict[str, Any]
    sha256: str


def read_weights(path: Path, group: str = "model") -> Weights:
    """Read a ``.safetensors`` file, or a torch checkpoint with tensors under the key ``group`` or
    at the top level.

    Checkpoints may contain only tensors and plain values. Files that would execute code are
    refused.

    Args:
        path: the file, or a published folder or address, see ``find_weights``.
        group: key of the tensors in a torch checkpoint.

    Raises:
        InputError: the file does not exist, is damaged, or contains code.
    """
    path = find_weights(path)
    if not path.is_file():
        raise InputError(f"no weights at {path}: check the path")
    digest = sha256_of(path)
    if path.suffix == ".safetensors":
        try:
            with safe_open(path, "pt") as file:
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
                config = parse_json((file.metadata() or {}).get("config", "{}"))
        except (SafetensorError, ValueError, OSError) as error:
            raise InputError(f"{path} is not a safetensors file of weights: {error}") from error
        if not isinstance(config, dict):
            raise InputError(f"{path} is not a safetensors file of weights: its config is damaged")
        return Weights(tensors, config, digest)
    try:
        with torch.serialization.safe_globals(_ALLOWED_TYPES):
            content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # damaged files raise many kinds of exceptions
        raise InputError(
            f"{path} cannot be read as tensors and plain values: {describe_fault(error)}"
        ) from error
    model = content.get(group, content) if isinstance(content, Mapping) else None
    if not isinstance(model, Mapping) or not any(isinstance(v, Tensor) for v in model.values()):
        raise InputError(f"{path} holds no tensors by name: give a checkpoint of a network")
    named = {str(name): value for name, value in model.items() if isinstance(value, Tensor)}
    return Weights(named, {}, digest)


def describe_fault(error: Exception) -> str:
    """Return what is wrong with a checkpoint, given the exception that torch raised.

    torch's own message is left out if it explains how to execute the code in the file.
    """
    text = str(error)
    if code := re.search(r"GLOBAL (\S+)", text):
        return f"it would execute {code[1]}"
    if "weights_only" in text:
        return "unsafe checkpoint: only tensors and plain values are loaded"
    return next(iter(text.splitlines()), type(error).__name__)


def write_weights(path: Path, network: nn.Module, config: Mapping[str, Any]) -> None:
    """Write the tensors of a network and its configuration atomically."""
    state = network.state_dict()
    tensors = {name: value.detach().cpu().contiguous() for name, value in state.items()}
    metadata = {"config": json.dumps(dict(config), sort_keys=True)}
    with atomic_write(path) as partial:
        partial.write_bytes(save(tensors, metadata))


def load_into(network: nn.Module, tensors: Mapping[str, Tensor], path: Path) -> None:
    """Load tensors into a network.

    Args:
        network: the network.
        tensors: tensors by the names of its ``state_dict``.
        path: file of the tensors, for errors.

    Raises:
        InputError: names, shapes or types are not those of the network, or a value is not finite.
    """
    state = network.state_dict()
    for name, value in state.items():
        if name not in tensors:
            raise InputError(f"{path} lacks {name}: give weights of this network")
        if tensors[name].shape != value.shape:
            raise InputError(
                f"{path}: {name} is {tuple(tensors[name].shape)}, the network's is "
                f"{tuple(value.shape)}: give weights of this network"
            )
        tensor = tensors[name]
        kinds = (
            tensor.is_floating_point(),
            tensor.is_complex(),
            tensor.is_quantized,
            tensor.layout,
        )
        if kinds != (value.is_floating_point(), False, False, torch.strided):
            raise InputError(
                f"{path}: {name} holds {str(tensor.dtype).removeprefix('torch.')}, the network's "
                f"holds {str(value.dtype).removeprefix('torch.')}: give weights of this network"
            )
        # A value that is finite in double precision may be infinite in single precision.
        if not bool(torch.isfinite(tensor.to(value.dtype)).all()):
            raise InputError(f"{path}: {name} has values that are not finite")
    extra = sorted(set(tensors) - set(state))
    if extra:
        raise InputError(
            f"{path} has {extra[0]}, which this network lacks: give weights of this network"
        )
    network.load_state_dict(dict(tensors))
