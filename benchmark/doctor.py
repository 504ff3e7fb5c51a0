"""The command ``doctor``, which checks the installation and prints commands that repair it.

It checks the machine, the versions of packages, the libraries of the system and the weights. It
needs only Python itself, so that it also runs as ``python -m benchmark.doctor`` or ``python
benchmark/doctor.py`` if the command line cannot start, even on a Python that is too old for the
other modules. It uses no network. Each package is imported in its own process, because importing a
broken one may crash the process.
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
if not __package__:  # run as a file: the packages of the project are not on the path
    sys.path.insert(0, str(_ROOT))

from simulate.render.libraries import missing_packages  # noqa: E402

# The packages that contain weights.
_WITH_WEIGHTS: Final = ("baselines", "objconnect")

_DISTRIBUTION: Final = "objconnect"
# Equal to requires-python in pyproject.toml. An older Python can load this module alone.
_PYTHON: Final = (3, 11)
# Modules of packages whose name differs from that of the package.
_MODULES: Final = {
    "opencv-python-headless": "cv2",
    "scikit-image": "skimage",
    "pyyaml": "yaml",
    "pillow": "PIL",
    "rerun-sdk": "rerun",
}
# Extras, one of the packages of each, and what is impossible without it.
_EXTRAS: Final = {
    "simulate": ("bpy", "rendering"),
    "cluster": ("ray", "--cluster"),
    "kornia": ("kornia", "matching by LightGlue"),
    "fast": ("numba", "aligning images and computing depth maps in less time"),
    "geo": ("pyproj", "coordinates by EPSG code and GeoTIFF"),
    "video": ("av", "--video"),
    "robot": ("pymavlink", "writing for autopilots and ROS 2"),
    "rerun": ("rerun-sdk", "export to rerun"),
    "hub": ("huggingface_hub", "publishing data sets and reading published ones"),
}
_BROWSERS: Final = ("chromium", "chromium-browser", "google-chrome")
# Importing torch takes long on a busy machine.
_TIMEOUT_S: Final = 300
# Free bytes below which no scene or result fits on a disk.
_MIN_FREE_BYTES: Final = 1e9
# Program that prints the names of the GPUs that torch can use.
_TORCH: Final = (
    "import json, torch; print(json.dumps([torch.cuda.get_device_name(k) "
    "for k in range(torch.cuda.device_count())] if torch.cuda.is_available() else []))"
)

State = Literal["ok", "absent", "missing"]


@dataclass(frozen=True)
class Check:
    """The check of one part of the installation.

    Attributes:
        name: name of the part.
        state: "ok", "absent" for a part that only some commands need, or "missing" for a
            requirement that is not met: a package or its version, a file, or free disk space.
        found: what is installed, or what is wrong with it.
        fix: command or advice that repairs it; empty if there is none.
    """

    name: str
    state: State
    found: str
    fix: str = ""


@dataclass(frozen=True)
class Diagnosis:
    """All checks of the installation."""

    checks: tuple[Check, ...]

    @property
    def ok(self) -> bool:
        """Whether all requirements are met."""
        return all(check.state != "missing" for check in self.checks)

    def as_dict(self) -> dict[str, Any]:
        """Return the diagnosis for a program."""
        return {"ok": self.ok, "checks": [asdict(check) for check in self.checks]}

    def text(self) -> str:
        """Return one line for each check and for each repair, and the result in the last line."""
        lines = []
        width = max(len(check.name) for check in self.checks)
        for check in self.checks:
            lines.append(f"{check.state:<8}{check.name:<{width}}  {check.found}")
            if check.fix:
                lines.append(f"{'':8}{'':<{width}}  fix: {check.fix}")
        unmet = sum(check.state == "missing" for check in self.checks)
        end = f"requirements not met: {unmet}" if unmet else "all requirements are met"
        return "\n".join([*lines, end])


class _Requirement(NamedTuple):
    """A required package, its versions, and the extra that needs it ("" for the project)."""

    package: str
    versions: str
    extra: str

    @property
    def module(self) -> str:
        return _MODULES.get(self.package.lower(), self.package.replace("-", "_"))

    def __str__(self) -> str:
        return self.package + self.versions

    @property
    def install_command(self) -> str:
        return f"{sys.executable} -m pip install '{self}'"


class _Loaded(NamedTuple):
    """The output of loading a package, or the error that prevented it."""

    output: str
    error: str


def doctor() -> Diagnosis:
    """Check the machine, the packages, the libraries that rendering needs, and the weights.

    If Python is too old, nothing else is checked.
    """
    if sys.version_info < _PYTHON:
        return Diagnosis((_python(),))
    requirements = _requirements()
    present = {extra for extra, (package, _) in _EXTRAS.items() if _version(package)}
    # The packages of an extra that is not installed are not loaded.
    loadable = [r for r in requirements if r.extra in {"", *present}]
    with ThreadPoolExecutor(min(4, _cores())) as pool:
        modules = list(dict.fromkeys(r.module for r in loadable))
        loaded = dict(zip(modules, pool.map(_load, modules), strict=True))
    checks = [
        *_machine(),
        _device(loaded["torch"]),
        *(_package(r, loaded[r.module]) for r in loadable),
        *_rendering("simulate" in present),
        *_extras(present - {"simulate"}),
        *_testing([r for r in requirements if r.extra == "test"]),
        *_weights([_ROOT / package for package in _WITH_WEIGHTS]),
    ]
    return Diagnosis(tuple(checks))


def _requirements() -> list[_Requirement]:
    """Return the requirements of the source tree of this file, else of the installed package."""
    import tomllib  # a Python that is too old does not have it

    project = _ROOT / "pyproject.toml"
    if project.is_file():
        table = tomllib.loads(project.read_text("utf-8"))["project"]
        groups = {"": table["dependencies"], **table["optional-dependencies"]}
        return [_requirement(text, extra) for extra, texts in groups.items() for text in texts]
    requirements = []
    for text in metadata.requires(_DISTRIBUTION) or []:
        extra = re.search(r"extra == [\"'](\w+)", text)
        requirements.append(_requirement(text, extra[1] if extra else ""))
    return requirements


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
    """Return whether a version lies within bounds such as ``>=1.26,<2``."""
    numbers = _numbers(version)
    return all(
        numbers >= _numbers(bound) if sign == ">=" else numbers < _numbers(bound)
        for sign, bound in re.findall(r"(>=|<)([\d.]+)", wanted)
    )


def _numbers(version: str) -> list[int]:
    release = re.match(r"[\d.]+", version)
    return [int(part) for part in (release[0] if release else "").split(".") if part]


def _load(module: str) -> _Loaded:
    """Import a module in its own process and return the output or the error."""
    code = _TORCH if module == "torch" else f"import {module}"
    try:
        answer = subprocess.run(
            [sys.executable, "-P", "-c", code],
            check=False,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_TIMEOUT_S,
        )
    except subprocess.TimeoutExpired:
        return _Loaded("", f"does not load within {_TIMEOUT_S} s")
    if answer.returncode == 0:
        return _Loaded(answer.stdout, "")
    errors = answer.stderr.strip().splitlines()
    return _Loaded("", errors[-1] if errors else f"its process ended with {answer.returncode}")


def _python() -> Check:
    version = f"{platform.python_version()} ({sys.executable}), {platform.platform()}"
    if sys.version_info >= _PYTHON:
        return Check("python", "ok", version)
    needed = ".".join(map(str, _PYTHON))
    debian = _apt([f"python{needed}-venv"])
    fix = f"install Python {needed} (on Debian: {debian}), then run the doctor with it"
    return Check("python", "missing", f"{version}; {needed} or newer is needed", fix)


def _machine() -> Iterator[Check]:
    yield _python()
    yield Check(_DISTRIBUTION, "ok", f"{_version(_DISTRIBUTION) or 'not installed'} ({_ROOT})")
    yield Check("cores", "ok", f"{_cores()}")
    memory = _memory()
    yield Check("memory", "ok", "unknown" if memory is None else f"{memory / 1e9:.1f} GB")
    for name, folder in (("disk here", Path.cwd()), ("disk temporary", _temporary_folder())):
        free = shutil.disk_usage(folder).free
        space = f"{free / 1e9:.1f} GB free in {folder}"
        if free < _MIN_FREE_BYTES:
            fix = "free some space, or " + ("set TMPDIR" if "temp" in name else "work elsewhere")
            yield Check(name, "missing", space, fix)
        else:
            yield Check(name, "ok", space)


def _cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _temporary_folder() -> Path:
    """Return the folder of temporary files, or the working folder where there is none."""
    try:
        return Path(tempfile.gettempdir())
    except FileNotFoundError:
        return Path.cwd()


def _memory() -> int | None:
    """Return the bytes of memory of the machine, or of a container with less; None if unknown."""
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
        return Check("GPU", "absent", "an NVIDIA GPU that this build of torch cannot use", fix)
    return Check("GPU", "absent", "none: networks run on the processor")


def _package(requirement: _Requirement, loaded: _Loaded) -> Check:
    """Check that a package is installed in a required version and can be loaded."""
    version, wanted = _version(requirement.package), requirement.versions
    why = f" for {requirement.extra}" if requirement.extra else ""
    name = requirement.package + why
    if version is not None and not _fits(version, wanted):
        return Check(name, "missing", f"{version} is not {wanted}", requirement.install_command)
    if loaded.error and version is None:
        return Check(
            name, "missing", f"not installed, {wanted} is needed", requirement.install_command
        )
    if loaded.error:
        packages = missing_packages() if requirement.package == "bpy" else []
        fix = _apt(packages) if packages else f"{requirement.install_command} --force-reinstall"
        return Check(name, "missing", f"{version} cannot be loaded: {loaded.error}", fix)
    return Check(name, "ok", version or "provided by another package")


def _rendering(installed: bool) -> Iterator[Check]:
    """Check the requirements of rendering; if bpy is not installed, none is "missing"."""
    packages = missing_packages()
    if not installed:
        fix = f"{sys.executable} -m pip install 'objconnect[simulate]'"
        if sys.version_info[:2] != (3, 11):
            fix = f"with Python 3.11, the only version that bpy supports: {fix}"
        yield Check("bpy", "absent", "not installed: rendering is not possible", fix)
    if packages:
        state: State = "missing" if installed else "absent"
        yield Check("Blender's libraries", state, f"without {', '.join(packages)}", _apt(packages))
    else:
        yield Check("Blender's libraries", "ok", "all installed")


def _extras(present: set[str]) -> Iterator[Check]:
    """Check the extras other than rendering; they are never "missing"."""
    for extra, (package, ability) in _EXTRAS.items():
        if extra not in {"simulate", *present}:
            fix = f"{sys.executable} -m pip install 'objconnect[{extra}]'"
            yield Check(package, "absent", f"not installed: {ability} is not possible", fix)


def _testing(requirements: list[_Requirement]) -> Iterator[Check]:
    """Check the packages of developers; they are never "missing"."""
    missing = [
        requirement
        for requirement in requirements
        if not _fits(_version(requirement.package) or "0", requirement.versions or ">=0.0.1")
    ]
    if missing:
        fix = f"{sys.executable} -m pip install {' '.join(repr(str(r)) for r in missing)}"
        yield Check("tests", "absent", f"without {', '.join(r.package for r in missing)}", fix)
    else:
        yield Check("tests", "ok", "all packages are installed")
    browser = next((path for name in _BROWSERS if (path := shutil.which(name))), None)
    if browser is None:
        effect = "none: the leaderboard's page cannot be tested"
        yield Check("Chromium", "absent", effect, _apt(["chromium"]))
    else:
        yield Check("Chromium", "ok", browser)


def _apt(packages: list[str]) -> str:
    return f"sudo apt-get install -y {' '.join(packages)}"


def _weights(folders: Sequence[Path]) -> Iterator[Check]:
    """Check that NAME.safetensors beside each card NAME.md that mentions it is complete."""
    found = sorted(card for folder in folders for card in folder.rglob("*.md"))
    cards = [card for card in found if f"{card.stem}.safetensors" in card.read_text("utf-8")]
    fix = f"install objconnect again, or git checkout {' '.join(_WITH_WEIGHTS)}"
    if not cards:
        named = " and ".join(str(folder) for folder in folders)
        yield Check("weights", "missing", f"{named} have none", fix)
    for card in cards:
        damage = _damage(card.with_suffix(".safetensors"))
        name = f"weights {card.stem}"
        yield Check(name, "missing", damage, fix) if damage else Check(name, "ok", "complete")


def _damage(path: Path) -> str:
    """Return what is wrong with a file of weights; empty for a complete file.

    The header of the file states its size. Format: https://huggingface.co/docs/safetensors
    (length of the header, header, tensors).
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
