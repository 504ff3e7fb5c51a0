"""Python programs that tests run in a process of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def run_and_print(program: str, **environment: str) -> str:
    """What a program prints, run in the root of the project."""
    answer = subprocess.run(
        [sys.executable, "-c", program],
        check=True,
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
    )
    return answer.stdout
