"""Options of dense reconstruction. ``dense.json`` records them beside what they made."""

from __future__ import annotations

from typing import Final

from pydantic import Field

from objconnect.scene.config import Config


class DenseOptions(Config):
    """Limits within which depth maps agree, and which depths are kept."""

    same_px: float = Field(
        1.0,
        gt=0,
        description="Two maps agree where the round trip of a pixel ends within this "
        "distance (px).",
    )
    same_depth: float = Field(
        0.01,
        gt=0,
        description="Two maps agree where their depths differ by less than this share.",
    )
    confirmed: int = Field(
        2, ge=1, description="A depth is kept when this many sources confirm it."
    )
    fused: int = Field(
        3, ge=1, description="A point of the cloud is kept when this many maps show it."
    )


DEFAULTS: Final = DenseOptions()
"""The default options."""
