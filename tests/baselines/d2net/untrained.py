"""Weights of a slim D2-Net that has learned nothing."""

from __future__ import annotations

from pathlib import Path

import torch

from baselines.d2net.network import D2Net, D2NetNetConfig
from objconnect.learning.checkpoint import write_weights


def create_untrained(folder: Path) -> Path:
    """Write them, always the same."""
    torch.manual_seed(0)
    config = D2NetNetConfig(width=0.125)
    path = folder / "untrained.safetensors"
    write_weights(path, D2Net(config), config.model_dump(mode="json"))
    return path
