"""Provenance of poses: the method with its configuration, and the versions of packages."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from objconnect.scene.localizer import Localizer
from objconnect.scene.storage.records import Record

# The only key in the configuration of an external method.
_POSES = "poses"


class Method(Record):
    """A method; ``config`` holds everything that changes its result."""

    name: str
    config: dict[str, Any]
    weights_sha256: str | None

    @staticmethod
    def of(localizer: Localizer) -> Method:
        """Return the record of a localizer."""
        return Method(
            name=localizer.name,
            config=localizer.config.model_dump(mode="json"),
            weights_sha256=localizer.weights_sha256,
        )

    @staticmethod
    def external(name: str, poses_sha256: str) -> Method:
        """Return the record of another program, of which only the poses are known."""
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

        def version_of(package: str) -> str:
            try:
                return version(package)
            except PackageNotFoundError:
                return "unknown"

        names = ("objconnect", "numpy", "torch", "pycolmap")
        return Environment(
            python=platform.python_version(), **{name: version_of(name) for name in names}
        )
