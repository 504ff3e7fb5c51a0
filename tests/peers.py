"""Run packages of other projects that read our exports, installed outside the environment.

``python -m tests.peers`` installs them into ``runs/peers`` without what they depend on: nerfstudio
alone would bring fifty packages, of which its readers need five small ones. What the readers
import and never use (viewers, point clouds) is replaced by mocks in the process that runs them.
numba's compiler is replaced by a decorator that does nothing.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).parents[1] / "runs" / "peers"
_PACKAGES = (
    "nerfstudio==1.1.5",
    "jaxtyping==0.2.36",
    "tyro==0.8.14",
    "shtab==1.7.1",
    "docstring_parser==0.16",
    "eval_type_backport==0.2.2",
    "wadler-lindig==0.1.3",
    "kapture==1.1.10",
    "numpy-quaternion==2023.0.4",
    "tqdm==4.67.1",
)
_PREAMBLE = """
import sys
from types import ModuleType
from unittest.mock import MagicMock
sys.path.append(sys.argv[1])
sys.modules["numba"] = ModuleType("numba")
sys.modules["numba"].njit = lambda *args, **options: args[0] if args else lambda function: function
for name in ("newrawpy", "open3d", "viser", "viser.transforms", "torch.utils.tensorboard"):
    sys.modules[name] = MagicMock()
"""


def install() -> None:
    """Install the packages, unless they are there."""
    done = FOLDER / ".installed"
    if done.exists() and done.read_text() == "\n".join(_PACKAGES):
        return
    pip = [sys.executable, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
    subprocess.run([*pip, "--no-deps", "--upgrade", "--target", FOLDER, *_PACKAGES], check=True)
    done.write_text("\n".join(_PACKAGES))


def run(program: str, *arguments: object) -> Any:
    """Run a program that may import the packages, and return the JSON that it prints last."""
    if not (FOLDER / ".installed").exists():
        pytest.fail(f"{FOLDER} lacks the packages of others: run python -m tests.peers")
    words = [str(word) for word in (FOLDER, *arguments)]
    command = [sys.executable, "-c", _PREAMBLE + program, *words]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout.splitlines()[-1])


if __name__ == "__main__":
    install()
