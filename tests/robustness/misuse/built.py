"""What a user installs, made of this checkout without a network: the wheel, and environments of it.

An environment is a ``venv`` of its own that sees, behind what is installed in it, the packages of
the Python that runs the tests: they are looked up, not installed again.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[3]
PACKAGES = ("objconnect", "simulate", "baselines", "benchmark")
# Of the tracks the descriptions and the digests of renders alone are installed.
BOARD = "benchmark/tracks"


@dataclass(frozen=True)
class Environment:
    """A Python with this project in it.

    Attributes:
        folder: of the virtual environment.
        ours: where the project's packages lie.
    """

    folder: Path
    ours: Path

    @property
    def python(self) -> str:
        return str(self.folder / "bin" / "python")

    def script(self, name: str) -> list[str]:
        """The words that begin the command of a console script."""
        return [self.python, str(self.folder / "bin" / name)]

    def run(
        self, command: list[str], cwd: Path, **variables: str
    ) -> subprocess.CompletedProcess[str]:
        """Run a command as a user would: nothing of the tests' own environment leads to the
        checkout."""
        env = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
        return subprocess.run(
            command, check=False, cwd=cwd, env={**env, **variables}, capture_output=True, text=True
        )


def source_tree(folder: Path) -> Path:
    """A copy of what is built from: building leaves files beside it."""
    folder.mkdir()
    rubbish = shutil.ignore_patterns("__pycache__")
    for name in PACKAGES:
        shutil.copytree(ROOT / name, folder / name, ignore=rubbish)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copyfile(ROOT / name, folder / name)
    return folder


def build_wheel(folder: Path) -> Path:
    """Build the wheel in a new folder."""
    source = source_tree(folder)
    _pip("wheel", "--no-build-isolation", "--wheel-dir", str(folder / "dist"), str(source))
    (wheel,) = (folder / "dist").glob("*.whl")
    return wheel


def install(folder: Path, *what: str) -> Environment:
    """Make an environment and install into it: a wheel, or ``-e`` and a source tree."""
    packages = create_environment(folder)
    python = str(folder / "bin" / "python")
    # Who runs the tests has the project installed already: that is neither enough nor touched.
    _pip("--python", python, "install", "--no-build-isolation", "--ignore-installed", *what)
    return Environment(folder, Path(what[-1]) if "-e" in what else packages)


def create_environment(folder: Path) -> Path:
    """Make an environment without the project, and return the folder of its packages."""
    venv.create(folder, symlinks=True)
    packages = Path(
        sysconfig.get_path("purelib", "venv", {"base": str(folder), "platbase": str(folder)})
    )
    # A list of folders. Such files that lie in them, as of an editable install, have no effect.
    seen = dict.fromkeys(sysconfig.get_path(kind) for kind in ("purelib", "platlib"))
    (packages / "tests.pth").write_text("\n".join(seen) + "\n")
    return packages


def _pip(*words: str) -> None:
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", *words]
    flags = ["--no-index", "--no-deps"]
    answer = subprocess.run([*command, *flags], check=False, capture_output=True, text=True)
    assert answer.returncode == 0, answer.stdout + answer.stderr
