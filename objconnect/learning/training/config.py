"""The configuration of a training."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import Field

from objconnect.learning.training.options import LossOptions, PairOptions
from objconnect.scene.config import Config


class TrainConfig(Config):
    """All settings that decide the weights, besides the scenes.

    Attributes:
        steps: number of steps of the optimizer.
        batch: number of pairs per step and process.
        crop: side of the square images, pixels.
        points: number of points per pair.
        rate: highest learning rate; the rate rises linearly and then falls as a cosine.
        rise: number of steps until the highest learning rate.
        decay: weight decay.
        clip: largest norm of the gradient.
        strength: strength of the photometric augmentation, 0 to 1.
        photographs: folders of aerial photographs, which are treated as flat ground.
        photograph_share: share of pairs made of these photographs during the warm-up; afterwards it
            is half of this.
        warm_up: share of the steps, at the start, in which features are trained without poses.
        width: width of a network from random weights; 1 is that of the authors.
        network: further options of the network, by the names of the method's configuration.
        weights: weights to start from; None starts from random ones.
        validate_every: number of steps between evaluations of the validation scenes.
        save_every: number of steps between checkpoints.
        workers: number of processes that make pairs.
        pairs: options of how pairs are drawn.
        losses: weights and limits of the losses.
        seed: seed of all random numbers.
    """

    steps: int = Field(3000, ge=1)
    batch: int = Field(8, ge=1)
    crop: int = Field(192, ge=96)
    points: int = Field(192, ge=64)
    rate: float = Field(1e-3, gt=0)
    rise: int = Field(50, ge=1)
    decay: float = Field(1e-4, ge=0)
    clip: float = Field(5.0, gt=0)
    strength: float = Field(0.5, ge=0, le=1)
    photographs: tuple[Path, ...] = ()
    photograph_share: float = Field(0.3, ge=0, le=1)
    warm_up: float = Field(0.35, ge=0, le=1)
    width: float = Field(0.25, gt=0, le=1)
    network: dict[str, Any] = Field(default_factory=dict)
    weights: Path | None = None
    validate_every: int = Field(200, ge=1)
    save_every: int = Field(100, ge=1)
    workers: int = Field(1, ge=0)
    pairs: PairOptions = PairOptions()
    losses: LossOptions = LossOptions()
    seed: int = 0
