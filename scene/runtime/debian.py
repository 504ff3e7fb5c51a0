"""System packages that no Python package brings."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence

from scene.errors import InputError


def require_packages(missing: Callable[[], Sequence[str]], what: str, install: bool) -> None:
    """Make sure Debian packages are there.

    Args:
        missing: names those that are not; asked again after installing.
        what: needs them, as the message begins.
        install: install missing ones, where this process is root and apt is there.

    Raises:
        InputError: some are missing; the message holds the line that installs them.
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
    """For the command line: 0 when everything is there, else 2 after one line."""
    try:
        require()
    except InputError as error:
        print(f"objconnect: error: {error}", file=sys.stderr)
        return 2
    return 0
