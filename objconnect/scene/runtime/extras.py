"""Import of packages of optional extras."""

from __future__ import annotations

import importlib
from types import ModuleType

from objconnect.scene.errors import InputError


def import_extra(module: str, extra: str, purpose: str) -> ModuleType:
    """Import a module of a package that an extra of the project installs.

    Args:
        module: dotted name of the module, such as ``rasterio.crs``.
        extra: extra that installs its package, such as ``geo``.
        purpose: subject of the message: the option or file format that needs it.

    Raises:
        InputError: the package is not installed, or its libraries cannot be loaded.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        if isinstance(error, ModuleNotFoundError) and error.name == module.partition(".")[0]:
            reason = "is not installed"
        else:
            reason = f"cannot be loaded ({str(error).partition(chr(10))[0]})"
        package = module.partition(".")[0]
        raise InputError(
            f"{purpose} needs {package}, which {reason}: pip install 'objconnect[{extra}]'"
        ) from None
