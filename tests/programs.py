"""Run Python programs in a process of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def run_and_print(program: str, **environment: str) -> str:
    """Run a program in the root of the project, and return what it prints."""
    answer = subprocess.run(
        [sys.executable, "-c", program],
        check=True,
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
    )
    return answer.stdout
