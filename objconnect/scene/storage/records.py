"""Base class of what files of ours hold as JSON."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Record(BaseModel):
    """Immutable; an unknown key, an infinite number or one that is none is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
