"""Entry point of scripts whose arguments are paths, with one-line errors."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from objconnect.scene.errors import InputError
from objconnect.scene.runtime.escaping import for_terminal

INPUT_AT_FAULT: Final = 2
"""Exit code if the input or the environment is wrong."""


def run_script(main: Callable[..., object], arguments: Sequence[str] | None = None) -> None:
    """Call the main function of a script with the paths of ``python script.py PATH...``.

    An InputError or OSError is printed as one line on standard error, and the process exits with
    code 2, as in the command line.

    Args:
        main: function whose parameters are paths.
        arguments: paths; None for those of the command line.
    """
    paths = [Path(path) for path in (sys.argv[1:] if arguments is None else arguments)]
    try:
        signature = inspect.signature(main)
        try:
            signature.bind(*paths)
        except TypeError as error:
            names = ", ".join(name.upper() for name in signature.parameters)
            raise InputError(f"{error}: give {names}, in this order") from None
        main(*paths)
    except (InputError, OSError) as error:
        line = for_terminal(" ".join(str(error).split()))
        print(f"error: {line}", file=sys.stderr)
        sys.exit(INPUT_AT_FAULT)
