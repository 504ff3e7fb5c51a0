"""Scripts of a person: their words are paths, and their faults end in one line."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from objconnect.scene.errors import InputError
from objconnect.scene.runtime.escaping import for_terminal

INPUT_AT_FAULT: Final = 2
"""The exit code when the input or the environment is at fault."""


def run_script(main: Callable[..., object], words: Sequence[str] | None = None) -> None:
    """Call the main function of a script with paths, as ``python script.py PATH...`` gives them.

    A fault that the user can correct is printed as one line on standard error, and the process ends
    with exit code 2, as the command line does it.

    Args:
        main: A function whose parameters are paths.
        words: The paths; by default, those of the command line.
    """
    paths = [Path(word) for word in (sys.argv[1:] if words is None else words)]
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
