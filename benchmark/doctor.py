"""Is everything there? Versions, libraries, machine and weights, and the line that mends a fault.

Needs nothing but Python itself, and runs as ``python -m benchmark.doctor`` or ``python
benchmark/doctor.py`` where the command line cannot, on a Python too old for everything else too.
Asks no network. Packages are loaded in processes of their own: one that crashes says so.
"""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

_ROOT: Final = Path(__file__).resolve().parents[1]
if not __package__:  # run by its file: our packages are not on the path
    sys.path.insert(0, str(_ROOT))

from simulate.render.libraries import missing_packages  # noqa: E402

# The packages that weights come with.
_WITH_WEIGHTS: Final = ("baselines", "objconnect", "mapping")

_DISTRIBUTION: Final = "objconnect"
# As requires-python in pyproject.toml. An older Python reads this module, and nothing else of ours.
_PYTHON: Final = (3, 11)
# What the module of a package is called where it is not called like the package.
_MODULES: Final = {
    "opencv-python-headless": "cv2",
    "scikit-image": "skimage",
    "pyyaml": "yaml",
    "pillow": "PIL",
}
_BROWSERS: Final = ("chromium", "chromium-browser", "google-chrome")
# Loading torch on a machine that does much else takes a while.
_PATIENCE_S: Final = 300
# With less free nothing that is worth writing fits.
_LEAST_FREE: Final = 1e9
# Beside the versions of packages, what torch finds to compute on.
_TORCH: Final = (
    "import json, torch; print(json.dumps([torch.cuda.get_device_name(k) "
    "for k in range(torch.cuda.device_count())] if torch.cuda.is_available() else []))"
)

State = Literal["ok", "absent", "missing"]


@dataclass(frozen=True)
class Check:
    """One thing that was looked at.

    Attributes:
        name: of the thing.
        state: "absent" is what only some commands need, "missing" what must be mended.
        found: what is there, or what is wrong with it.
        fix: the line that mends it; empty where there is nothing to mend.
    """

    name: str
    state: State
    found: str
    fix: str = ""


@dataclass(frozen=True)
class Diagnosis:
    """Everything that was looked at."""

    checks: tuple[Check, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing needed is missing."""
        return all(check.state != "missing" for check in self.checks)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"ok": self.ok, "checks": [asdict(check) for check in self.checks]}

    def text(self) -> str:
        """For people, a line each, and a line each for what mends it."""
        lines = []
        width = max(len(check.name) for check in self.checks)
        for check in self.checks:
            lines.append(f"{check.state:<8}{check.name:<{width}}  {check.found}")
            if check.fix:
                lines.append(f"{'':8}{'':<{width}}  fix: {check.fix}")
        missing = sum(check.state == "missing" for check in self.checks)
        lines.append("nothing needed is missing" if self.ok else f"{missing} needed things missing")
        return "\n".join(lines)


class _Requirement(NamedTuple):
    """A package, the versions of it that do, and the extra that asks for it ("" for all)."""

    package: str
    versions: str
    extra: str

    @property
    def module(self) -> str:
        return _MODULES.get(self.package.lower(), self.package.replace("-", "_"))

    def __str__(self) -> str:
        return self.package + self.versions

    @property
    def pip(self) -> str:
        return f"{sys.executable} -m pip install '{self}'"


class _Loaded(NamedTuple):
    """What a package said when it was loaded: its output, or why it could not be."""

    output: str
    error: str


def doctor() -> Diagnosis:
    """Look at the machine, the packages, what rendering needs, and the shipped weights.

    On a Python that is too old, what it has of packages says nothing: it alone is named.
    """
    if sys.version_info < _PYTHON:
        return Diagnosis((_python(),))
    requirements = _requirements()
    rendering = _version("bpy") is not None
    # What is not wanted is not looked for.
    wanted = {"", *(["simulate"] if rendering else []), *(["cluster"] if _version("ray") else [])}
    loadable = [r for r in requirements if r.extra in wanted]
    with ThreadPoolExecutor(min(4, _cores())) as pool:
        modules = list(dict.fromkeys(r.module for r in loadable))
        loaded = dict(zip(modules, pool.map(_load, modules), strict=True))
    checks = [
        *_machine(),
        _device(loaded["torch"]),
        *(_package(r, loaded[r.module]) for r in loadable),
        *_rendering(rendering),
        *_cluster("cluster" in wanted),
        *_testing([r for r in requirements if r.extra == "test"]),
        *_weights([_ROOT / package for package in _WITH_WEIGHTS]),
    ]
    return Diagnosis(tuple(checks))


def _requirements() -> list[_Requirement]:
    """Of the source tree this file lies in, else of the installed package."""
    import tomllib  # no part of a Python that is too old

    project = _ROOT / "pyproject.toml"
    if project.is_file():
        table = tomllib.loads(project.read_text("utf-8"))["project"]
        groups = {"": table["dependencies"], **table["optional-dependencies"]}
        return [_requirement(text, extra) for extra, texts in groups.items() for text in texts]
    found = []
    for text in metadata.requires(_DISTRIBUTION) or []:
        extra = re.search(r"extra == [\"'](\w+)", text)
        found.append(_requirement(text, extra[1] if extra else ""))
    return found


def _requirement(text: str, extra: str) -> _Requirement:
    package = re.match(r"[\w.-]+", text)
    assert package is not None
    versions = text[package.end() :].partition(";")[0]
    return _Requirement(package[0], "".join(versions.split()), extra)


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _fits(version: str, wanted: str) -> bool:
    """Whether a version is at least ``>=`` and below ``<``, the bounds this project uses."""
    have = _numbers(version)
    return all(
        have >= _numbers(bound) if sign == ">=" else have < _numbers(bound)
        for sign, bound in re.findall(r"(>=|<)([\d.]+)", wanted)
    )


def _numbers(version: str) -> list[int]:
    release = re.match(r"[\d.]+", version)
    return [int(part) for part in (release[0] if release else "").split(".") if part]


def _load(module: str) -> _Loaded:
    """Load a module in a process of its own."""
    code = _TORCH if module == "torch" else f"import {module}"
    try:
        answer = subprocess.run(
            [sys.executable, "-P", "-c", code],
            check=False,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_PATIENCE_S,
        )
    except subprocess.TimeoutExpired:
        return _Loaded("", f"does not load within {_PATIENCE_S} s")
    if answer.returncode == 0:
        return _Loaded(answer.stdout, "")
    said = answer.stderr.strip().splitlines()
    return _Loaded("", said[-1] if said else f"its process ended with {answer.returncode}")


def _python() -> Check:
    found = f"{platform.python_version()} ({sys.executable}), {platform.platform()}"
    if sys.version_info >= _PYTHON:
        return Check("python", "ok", found)
    needed = ".".join(map(str, _PYTHON))
    debian = _apt([f"python{needed}-venv"])
    fix = f"install Python {needed} (on Debian: {debian}), then run the doctor with it"
    return Check("python", "missing", f"{found}; {needed} or newer is needed", fix)


def _machine() -> Iterator[Check]:
    yield _python()
    yield Check(_DISTRIBUTION, "ok", f"{_version(_DISTRIBUTION) or 'not installed'} ({_ROOT})")
    yield Check("cores", "ok", f"{_cores()}")
    memory = _memory()
    yield Check("memory", "ok", "unknown" if memory is None else f"{memory / 1e9:.1f} GB")
    for name, folder in (("disk here", Path.cwd()), ("disk temporary", _temporary())):
        free = shutil.disk_usage(folder).free
        found = f"{free / 1e9:.1f} GB free in {folder}"
        if free < _LEAST_FREE:
            fix = "free some, or " + ("set TMPDIR" if "temp" in name else "work elsewhere")
            yield Check(name, "missing", found, fix)
        else:
            yield Check(name, "ok", found)


def _cores() -> int:
    """Those this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _temporary() -> Path:
    """The folder of temporary files; the working folder where there is none."""
    try:
        return Path(tempfile.gettempdir())
    except FileNotFoundError:
        return Path.cwd()


def _memory() -> int | None:
    """Bytes of the machine, or of the container where that has fewer."""
    try:
        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # AttributeError: Windows has no sysconf
        return None
    try:
        limit = Path("/sys/fs/cgroup/memory.max").read_text().strip()
    except OSError:
        return total
    return min(total, int(limit)) if limit.isdecimal() else total


def _device(torch: _Loaded) -> Check:
    names = json.loads(torch.output.splitlines()[-1]) if torch.output else []
    if names:
        return Check("GPU", "ok", ", ".join(names))
    if Path("/dev/nvidiactl").exists() and not torch.error:
        fix = "install the CUDA build of torch, see https://pytorch.org/get-started/locally"
        return Check("GPU", "absent", "there is one, but this build of torch cannot use it", fix)
    return Check("GPU", "absent", "none: networks run on the processor")


def _package(requirement: _Requirement, loaded: _Loaded) -> Check:
    """A package that must be there, of a version that does, and loads."""
    version, wanted = _version(requirement.package), requirement.versions
    why = f" for {requirement.extra}" if requirement.extra else ""
    name = requirement.package + why
    if version is not None and not _fits(version, wanted):
        return Check(name, "missing", f"{version} is not {wanted}", requirement.pip)
    if loaded.error and version is None:
        return Check(name, "missing", f"not installed, {wanted} is needed", requirement.pip)
    if loaded.error:
        packages = missing_packages() if requirement.package == "bpy" else []
        fix = _apt(packages) if packages else f"{requirement.pip} --force-reinstall"
        return Check(name, "missing", f"{version} cannot be loaded: {loaded.error}", fix)
    return Check(name, "ok", version or "of another package")


def _rendering(installed: bool) -> Iterator[Check]:
    """What simulate, calibrate and gallery need; nothing is missing where bpy is not wanted."""
    packages = missing_packages()
    if not installed:
        fix = f"{sys.executable} -m pip install 'objconnect[simulate]'"
        if sys.version_info[:2] != (3, 11):
            fix = f"with Python 3.11, for which alone it is made: {fix}"
        yield Check("bpy", "absent", "not installed: rendering is not possible", fix)
    if packages:
        found = f"without {', '.join(packages)}"
        yield Check(
            "Blender's libraries", "missing" if installed else "absent", found, _apt(packages)
        )
    else:
        yield Check("Blender's libraries", "ok", "all there")


def _cluster(installed: bool) -> Iterator[Check]:
    """What ``--cluster`` needs; never missing."""
    if not installed:
        fix = f"{sys.executable} -m pip install 'objconnect[cluster]'"
        yield Check("ray", "absent", "not installed: --cluster is not possible", fix)


def _testing(requirements: list[_Requirement]) -> Iterator[Check]:
    """What developers need; never missing."""
    lacking = [
        requirement
        for requirement in requirements
        if not _fits(_version(requirement.package) or "0", requirement.versions or ">=0.0.1")
    ]
    if lacking:
        fix = f"{sys.executable} -m pip install {' '.join(repr(str(r)) for r in lacking)}"
        yield Check("tests", "absent", f"without {', '.join(r.package for r in lacking)}", fix)
    else:
        yield Check("tests", "ok", "all packages there")
    browser = next((path for name in _BROWSERS if (path := shutil.which(name))), None)
    if browser is None:
        found = "none: the leaderboard's page cannot be tested"
        yield Check("Chromium", "absent", found, _apt(["chromium"]))
    else:
        yield Check("Chromium", "ok", browser)


def _apt(packages: list[str]) -> str:
    return f"sudo apt-get install -y {' '.join(packages)}"


def _weights(folders: Sequence[Path]) -> Iterator[Check]:
    """Weights have a card beside them: where there is one, the other must be whole."""
    cards = sorted(card for folder in folders for card in folder.rglob("*.md"))
    again = f"install objconnect again, or git checkout {' '.join(_WITH_WEIGHTS)}"
    if not cards:
        named = " and ".join(str(folder) for folder in folders)
        yield Check("weights", "missing", f"{named} have none", again)
    for card in cards:
        wrong = _damage(card.with_suffix(".safetensors"))
        name = f"weights {card.stem}"
        yield Check(name, "missing", wrong, again) if wrong else Check(name, "ok", "whole")


def _damage(path: Path) -> str:
    """What is wrong with a file of weights: its header says how long it is. Empty for nothing.

    Format: https://huggingface.co/docs/safetensors (length of the header, header, tensors).
    """
    try:
        with path.open("rb") as file:
            length = int.from_bytes(file.read(8), "little")
            header = json.loads(file.read(min(length, path.stat().st_size)))
            size = path.stat().st_size
        ends = [entry["data_offsets"][1] for name, entry in header.items() if name[0] != "_"]
    except OSError as error:
        return f"{path}: {error.strerror}"
    except (ValueError, AttributeError, KeyError, TypeError, IndexError):
        return f"{path} is damaged"
    return "" if max(ends, default=0) + length + 8 == size else f"{path} is cut short"


if __name__ == "__main__":
    diagnosis = doctor()
    print(diagnosis.text())
    sys.exit(0 if diagnosis.ok else 2)
