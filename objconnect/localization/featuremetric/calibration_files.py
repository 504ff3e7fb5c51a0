"""Calibration files: small YAML files beside the weights of a network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Self

import yaml

from objconnect.learning.weights_file import find_weights
from objconnect.scene.config import Config, load_config
from objconnect.scene.storage.atomic import write_text


class CalibrationFile(Config):
    """Calibration numbers of one network: ``NAME.KIND.yaml`` beside its ``NAME.safetensors``.

    The shipped networks share one file, ``KIND.yaml`` beside this module.
    """

    kind: ClassVar[str]

    @classmethod
    def from_values(cls, values: Sequence[object]) -> Self:
        """Return the calibration with these values, in the order of the fields."""
        return cls(**dict(zip(cls.model_fields, values, strict=True)))

    @classmethod
    def shipped_path(cls) -> Path:
        """Return the file of the shipped networks."""
        return Path(__file__).with_name(f"{cls.kind}.yaml")

    @classmethod
    def path_beside(cls, weights: Path) -> Path:
        """Return the path of the calibration file that belongs to a file of weights."""
        return weights.with_suffix(f".{cls.kind}.yaml")

    @classmethod
    def load_beside(cls, weights: Path | None) -> Self:
        """Read the file beside weights, or the file of the shipped networks if there is none.

        Args:
            weights: the user's weights, see ``find_weights``; None for the shipped ones.

        Raises:
            InputError: the file is damaged, or a field is unknown or missing.
        """
        path = cls.shipped_path() if weights is None else cls.path_beside(find_weights(weights))
        return load_config(cls, path if path.exists() else cls.shipped_path(), {})

    def write(self, path: Path, command: str) -> None:
        """Write the file that ``load_beside`` reads.

        Args:
            path: path of the file.
            command: command that found the numbers, for the first line.

        Raises:
            WriteError: the folder cannot be written, or the disk is full.
        """
        values = yaml.safe_dump(self.model_dump(), sort_keys=False, default_flow_style=None)
        write_text(path, f"# From {command}.\n{values}")
