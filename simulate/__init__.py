"""Render scenes: procedural worlds, conditions, drone flights and exact annotations."""

from __future__ import annotations

from typing import TYPE_CHECKING

from objconnect.scene.runtime.lazy import lazy_attributes

if TYPE_CHECKING:
    from simulate.calibration import calibrate as calibrate
    from simulate.command import simulate as simulate
    from simulate.config import SimulateConfig as SimulateConfig

_TARGETS = {
    "simulate": "simulate.command",
    "calibrate": "simulate.calibration",
    "SimulateConfig": "simulate.config",
}

__all__ = list(_TARGETS)

__getattr__, __dir__ = lazy_attributes(__name__, _TARGETS)
