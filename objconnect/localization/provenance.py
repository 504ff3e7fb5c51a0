"""Provenance of poses: the method, its configuration and weights, and the versions of packages."""

from __future__ import annotations

import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from objconnect.scene.localizer import Localizer
from objconnect.scene.storage.records import Record

# The only key in the configuration of an external method; the value is a digest of its poses.
_POSES = "poses"


class Method(Record):
    """A method; ``config`` holds the effective value of every option that changes its result.

    ``objects`` states which objects a method uses: "none", or "learned" with the file of their
    weights and its digest; None for a method that cannot use objects.
    """

    name: str
    config: dict[str, Any]
    weights_sha256: str | None
    objects: str | None = None

    @staticmethod
    def of(localizer: Localizer) -> Method:
        """Return the description of a localizer."""
        return Method(
            name=localizer.name,
            config=localizer.config.model_dump(mode="json"),
            weights_sha256=localizer.weights_sha256,
            objects=getattr(localizer, "objects", None),
        )

    @staticmethod
    def external(name: str, poses_sha256: str) -> Method:
        """Return the description of another program, whose configuration is unknown."""
        return Method(name=name, config={_POSES: poses_sha256}, weights_sha256=None)

    @property
    def is_external(self) -> bool:
        """Return whether the poses came from another program."""
        return set(self.config) == {_POSES}


class Environment(Record):
    """Versions of the packages that compute the poses."""

    objconnect: str
    python: str
    numpy: str
    torch: str
    pycolmap: str

    @staticmethod
    def current() -> Environment:
        """Return the versions in this process; "unknown" for a package that is not installed."""
        names = ("objconnect", "numpy", "torch", "pycolmap")
        return Environment(
            python=platform.python_version(), **{name: _version_of(name) for name in names}
        )


@cache
def _version_of(package: str) -> str:
    """Return the version of a package, whose metadata is parsed once in a process."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"
