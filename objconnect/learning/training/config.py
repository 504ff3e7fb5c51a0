"""The configuration of a training."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import Field

from objconnect.learning.training.options import LOSSES, PAIRS, LossOptions, PairOptions
from objconnect.scene.config import Config
from objconnect.scene.runtime.device import AUTO, Device


class TrainConfig(Config):
    """All settings of a training except the scenes."""

    steps: int = Field(3000, ge=1, description="Number of steps of the optimizer.")
    batch: int = Field(8, ge=1, description="Number of pairs per step and process.")
    crop: int = Field(192, ge=96, description="Side of the square images, px.")
    points: int = Field(192, ge=64, description="Number of points per pair.")
    rate: float = Field(
        1e-3,
        gt=0,
        description="Highest learning rate. The rate rises linearly at first and falls along a "
        "cosine.",
    )
    strength: float = Field(
        0.5, ge=0, le=1, description="Strength of the photometric augmentation, 0 to 1."
    )
    photographs: tuple[Path, ...] = Field(
        (), description="Folders of aerial photographs, whose ground is assumed to be flat."
    )
    photograph_share: float = Field(
        0.3,
        ge=0,
        le=1,
        description="Share of the pairs that are made of ``photographs``. It is halved after the "
        "warm-up; if ``warm_up`` is 0, it is never halved.",
    )
    warm_up: float = Field(
        0.35,
        ge=0,
        le=1,
        description="Share of the steps, at the start, in which features are trained without "
        "the pose loss.",
    )
    width: float = Field(
        0.25,
        gt=0,
        le=1,
        description="Number of channels of the encoder as a share of VGG16's, for a network with "
        "random initial weights.",
    )
    network: dict[str, Any] = Field(
        default_factory=dict,
        description="Further options of the network, by the names of its configuration's fields.",
    )
    weights: Path | None = Field(None, description="File of initial weights; None for random ones.")
    validate_every: int = Field(200, ge=1, description="Number of steps between validations.")
    save_every: int = Field(100, ge=1, description="Number of steps between checkpoints.")
    workers: int = Field(1, ge=0, description="Number of data loading processes.")
    # Under ``torchrun``, each process takes its own CUDA device unless a number is given.
    device: Device = AUTO
    pairs: PairOptions = Field(PAIRS, description="Options of the training pairs.")
    losses: LossOptions = Field(LOSSES, description="Weights of the losses.")
    seed: int = Field(0, description="Seed of all random numbers.")
