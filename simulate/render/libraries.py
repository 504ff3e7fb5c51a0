"""Check the system libraries that Blender's Python module needs.

``python -m simulate.render.libraries`` checks them. As root with apt it installs missing libraries;
otherwise it prints the command that installs them.
"""

from __future__ import annotations

import ctypes
import sys
from typing import Final

from objconnect.scene.runtime.debian import check, require_packages

# Debian package of each shared library that bpy 4.5 needs.
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
    """Return the Debian packages of the libraries that cannot be loaded."""
    return [package for library, package in PACKAGES.items() if not _loads(library)]


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def require_libraries(install: bool = False) -> None:
    """Check that Blender's libraries can be loaded.

    Args:
        install: whether to install missing ones, where this process is root and apt exists.

    Raises:
        InputError: libraries are missing; the message contains the command that installs them.
    """
    require_packages(missing_packages, "Blender needs system libraries that are", install)


if __name__ == "__main__":
    sys.exit(check(lambda: require_libraries(install=True)))
