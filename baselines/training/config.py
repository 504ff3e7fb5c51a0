"""How a network is trained."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import Field

from baselines.training.options import LossOptions, PairOptions
from scene.config import Config


class TrainConfig(Config):
    """Everything that decides the weights, beside the scenes.

    Attributes:
        steps: of the optimizer.
        batch: pairs per step and process.
        crop: side of the square images, pixels.
        points: per pair.
        rate: learning rate at its peak; it rises over the first steps and falls as a cosine.
        rise: steps until the peak.
        decay: weight decay.
        clip: largest norm of the gradient.
        strength: of the photometric augmentation, 0 to 1.
        photographs: folders of aerial photographs, taken for flat ground.
        photograph_share: of pairs made of them, where there are any, over the first `warm_up` of
            the steps; afterwards half as many.
        warm_up: share of the steps in which features alone are taught, without poses.
        width: of the network, 1 for the authors' own.
        network: what else it is made of, by the names of the method's own configuration.
        weights: to start from, or None to start from nothing.
        validate_every: steps between two looks at the validation scenes.
        save_every: steps between two checkpoints.
        workers: processes that make pairs.
        pairs: how pairs are drawn.
        losses: what the losses weigh.
        seed: of everything drawn.
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
