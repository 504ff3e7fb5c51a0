"""The device that networks and alignment compute on, and whether compiled loops serve it."""

from __future__ import annotations

import logging
import re
from functools import cache
from typing import TYPE_CHECKING, Annotated, Final

from pydantic import AfterValidator, Field

from objconnect.scene.errors import InputError
from objconnect.scene.runtime.loops import has_compiler

if TYPE_CHECKING:
    import torch

log = logging.getLogger(__name__)


def resolve_device(asked: str) -> str:
    """Return the device that a name stands for here: ``auto`` is CUDA where torch finds it.

    Raises:
        ValueError: it is no name of a device, or torch does not find that device.
    """
    import torch

    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if asked == "auto":
        return "cuda" if count else "cpu"
    if asked == "cpu":
        return asked
    named = re.fullmatch(r"cuda(?::(\d{1,3}))?", asked)
    if named is None:
        raise ValueError("a device is auto, cpu, cuda or cuda:NUMBER")
    if not count:
        raise ValueError("torch finds no CUDA device here: take cpu or auto")
    if int(named[1] or 0) >= count:
        raise ValueError(f"torch finds cuda:0 to cuda:{count - 1} here: take one of them")
    return asked


Device = Annotated[
    str,
    Field(
        description="Device that networks and alignment compute on: auto, cpu, cuda or "
        "cuda:NUMBER. auto is cuda where torch finds a CUDA device, else cpu.",
        validate_default=True,
    ),
    AfterValidator(resolve_device),
]
"""A field of a configuration. ``auto`` becomes what it stands for, so that results record it."""

AUTO: Final = "auto"
"""The default of every ``Device``."""


@cache
def torch_device(asked: str = AUTO) -> torch.device:
    """Return a device for torch by its name, and log it at its first use.

    Raises:
        InputError: it is no name of a device, or torch does not find that device.
    """
    import torch

    try:
        device = torch.device(resolve_device(asked))
    except ValueError as error:
        raise InputError(f"device {asked!r}: {error}") from None
    log.info("computing on %s", device)
    return device


def loops_serve(device: torch.device) -> bool:
    """Return whether compiled loops can compute there: they run on the processor alone."""
    return device.type == "cpu" and has_compiler()
