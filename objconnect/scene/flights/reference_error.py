"""The error of the reference poses that results are scored against, ``reference_error.json``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final, Literal

from pydantic import Field, model_validator

from objconnect.scene.bundle.manifest import read_json
from objconnect.scene.storage.records import Record

REFERENCE_ERROR: Final = "reference_error.json"
"""Name of the file in the folder of a flight."""

# Recall at a threshold is reported if the error of the reference poses is at most this share of it.
_MAX_ERROR_SHARE: Final = 0.5


class ReferencePoseError(Record):
    """How far the reference positions of a flight may be from the truth.

    Attributes:
        metres: error that 90 % of the positions do not exceed, metres; None if it is unknown.
        source: how the error is known: somebody stated it, it was measured, or it is unknown.
    """

    metres: float | None = Field(ge=0)
    source: Literal["stated", "measured", "unknown"]

    @model_validator(mode="after")
    def _agree(self) -> ReferencePoseError:
        if (self.metres is None) != (self.source == "unknown"):
            raise ValueError("metres is null if the source is unknown, and a number otherwise")
        return self

    def can_judge(self, threshold_m: float) -> bool:
        """Return whether the reference poses are exact enough for recall at a threshold, metres.

        Their error may be at most half of the threshold, and must be known.
        """
        return self.metres is not None and self.metres <= _MAX_ERROR_SHARE * threshold_m

    def text(self) -> str:
        """Return the error, and from which threshold on recall can be measured, in one line."""
        if self.metres is None:
            return "reference poses: their error is unknown, so recall cannot be measured"
        return (
            f"reference poses: 90 % within {self.metres:.2f} m ({self.source}); recall below "
            f"{self.metres / _MAX_ERROR_SHARE:.2f} m cannot be measured"
        )


def read_reference_error(flight: Path) -> ReferencePoseError | None:
    """Read the ``reference_error.json`` of a flight; None if it has none.

    Raises:
        InputError: the file cannot be read or is not such a record.
    """
    file = flight / REFERENCE_ERROR
    if not os.path.lexists(file):
        return None
    return read_json(file, ReferencePoseError, "error of the reference poses")
