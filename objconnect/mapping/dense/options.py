"""Options of ``dense``, which ``dense.json`` records beside the depth maps."""

from __future__ import annotations

from typing import Final

from pydantic import Field

from objconnect.scene.config import Config


class DenseOptions(Config):
    """Thresholds of geometric consistency and fusion of depth maps."""

    same_px: float = Field(
        1.0,
        gt=0,
        description="Two depth maps agree at a pixel where its reprojection error after a round "
        "trip is below this, px.",
    )
    confirmed: int = Field(
        2, ge=1, description="Minimum number of other depth maps that must confirm a depth."
    )
    fused: int = Field(
        3, ge=1, description="Minimum number of depth maps that must show a point of the cloud."
    )


DEFAULTS: Final = DenseOptions()
"""The default options."""
