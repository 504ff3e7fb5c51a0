"""The system libraries that Blender's module needs and no Python package brings.

``python -m simulate.render.libraries`` checks them, installs what is missing where it
may (root and apt), and otherwise prints the line that does.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
from typing import Final

from scene.errors import InputError

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
    packages = missing_packages()
    if packages and install and os.geteuid() == 0 and shutil.which("apt-get"):
        print(f"installing {' '.join(packages)}", file=sys.stderr)
        subprocess.run(["apt-get", "-qq", "update"], check=False)
        quiet = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        command = ["apt-get", "-qq", "install", "--no-install-recommends", "-y", *packages]
        subprocess.run(command, check=False, env=quiet, stdout=subprocess.DEVNULL)
        packages = missing_packages()
    if packages:
        raise InputError(
            f"Blender needs system libraries that are missing: run "
            f"'sudo apt-get install -y {' '.join(packages)}'"
        )


def main() -> int:
    """Check and install; 0 when everything is there, else 2 after one line."""
    try:
        require_libraries(install=True)
    except InputError as error:
        print(f"objconnect: error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
