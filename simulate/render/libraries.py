"""The system libraries that Blender's module needs and no Python package brings.

``python -m simulate.render.libraries`` checks them, installs what is missing where it
may (root and apt), and otherwise prints the line that does.
"""

from __future__ import annotations

import ctypes
import sys
from typing import Final

from scene.runtime.debian import check, require_packages

# Shared library -> Debian package, of bpy 4.5.
PACKAGES: Final = {
    "libX11.so.6": "libx11-6",
    "libXrender.so.1": "libxrender1",
    "libXfixes.so.3": "libxfixes3",
    "libXi.so.6": "libxi6",
    "libXext.so.6": "libxext6",
    "libxkbcommon.so.0": "libxkbcommon0",
    "libSM.so.6": "libsm6",
    "libICE.so.6": "libice6",
    "libGL.so.1": "libgl1",
}


def missing_packages() -> list[str]:
    """Debian packages of the libraries that cannot be loaded."""
    return [package for library, package in PACKAGES.items() if not _loads(library)]


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def require_libraries(install: bool = False) -> None:
    """Make sure Blender's libraries are there.

    Args:
        install: install missing ones, where this process is root and apt is there.

    Raises:
        InputError: some are missing; the message holds the line that installs them.
    """
    require_packages(missing_packages, "Blender needs system libraries that are", install)


if __name__ == "__main__":
    sys.exit(check(lambda: require_libraries(install=True)))
