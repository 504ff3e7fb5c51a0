"""Debian packages that Python packages do not install."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence

from objconnect.scene.errors import InputError


def require_packages(missing: Callable[[], Sequence[str]], what: str, install: bool) -> None:
    """Check that Debian packages are installed, or install them.

    Args:
        missing: returns the missing packages; it is called again after installing.
        what: beginning of the message, such as "Blender needs system libraries that are".
        install: whether to install missing packages if this process is root and apt exists.

    Raises:
        InputError: packages are missing; the message has the command that installs them.
    """
    packages = missing()
    if packages and install and os.geteuid() == 0 and shutil.which("apt-get"):
        print(f"installing {' '.join(packages)}", file=sys.stderr)
        subprocess.run(["apt-get", "-qq", "update"], check=False)
        quiet = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        command = ["apt-get", "-qq", "install", "--no-install-recommends", "-y", *packages]
        subprocess.run(command, check=False, env=quiet, stdout=subprocess.DEVNULL)
        packages = missing()
    if packages:
        raise InputError(f"{what} missing: run 'sudo apt-get install -y {' '.join(packages)}'")


def check(require: Callable[[], object]) -> int:
    """Run a check for the command line; return exit code 0, or 2 after an error message."""
    try:
        require()
    except InputError as error:
        print(f"objconnect: error: {error}", file=sys.stderr)
        return 2
    return 0
