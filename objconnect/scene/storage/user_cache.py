"""The folder of this program in the user's cache."""

from __future__ import annotations

import os
from pathlib import Path


def user_cache() -> Path | None:
    """Return ``$XDG_CACHE_HOME/objconnect`` or ``~/.cache/objconnect``; None without a home."""
    try:
        base = Path(os.environ.get("XDG_CACHE_HOME", ""))
        base = base if base.is_absolute() else Path.home() / ".cache"
    except RuntimeError:  # the home folder is unknown
        return None
    return base / "objconnect"
