"""Skip tests that need Blender's Python module, which is optional, where it is not installed."""

from __future__ import annotations

from importlib.util import find_spec

import pytest


def has_blender() -> bool:
    """Return whether Blender's module is installed."""
    return find_spec("bpy") is not None


def require_blender(*_: object) -> None:
    """Skip the test where Blender's module is not installed."""
    if not has_blender():
        pytest.skip("bpy is not installed: pip install 'objconnect[simulate]' (Python 3.11)")
