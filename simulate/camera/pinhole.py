"""The pinhole camera that Blender renders."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class PinholeCamera(BaseModel):
    """A camera without distortion, in COLMAP's pixels: the first pixel's centre is (0.5, 0.5)."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    width: int = Field(gt=0)
    height: int = Field(gt=0)
    f: float = Field(gt=0)
    cx: float
    cy: float
