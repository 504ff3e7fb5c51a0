"""The device that networks and alignment compute on."""

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


def resolve_device(name: str) -> str:
    """Resolve the name of a device; ``auto`` is CUDA if torch finds it, else the CPU.

    Raises:
        ValueError: the name is invalid, or torch does not find the device.
    """
    import torch

    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if name == "auto":
        return "cuda" if count else "cpu"
    if name == "cpu":
        return name
    match = re.fullmatch(r"cuda(?::(\d{1,3}))?", name)
    if match is None:
        raise ValueError("a device is auto, cpu, cuda or cuda:NUMBER")
    if not count:
        raise ValueError("torch finds no CUDA device: choose cpu or auto")
    if int(match[1] or 0) >= count:
        raise ValueError(f"torch finds cuda:0 to cuda:{count - 1}: choose one of them")
    return name


Device = Annotated[
    str,
    Field(
        description="Device of networks and alignment: auto, cpu, cuda or cuda:NUMBER. auto is "
        "cuda if torch finds a CUDA device, else cpu.",
        validate_default=True,
    ),
    AfterValidator(resolve_device),
]
"""A configuration field; ``auto`` is resolved, so that results record the device."""

AUTO: Final = "auto"
"""The default of every ``Device``."""


@cache
def torch_device(name: str = AUTO) -> torch.device:
    """Return the torch device with a name, and log it at its first use.

    Raises:
        InputError: the name is invalid, or torch does not find the device.
    """
    import torch

    try:
        device = torch.device(resolve_device(name))
    except ValueError as error:
        raise InputError(f"device {name!r}: {error}") from None
    log.info("computing on %s", device)
    return device


def supports_loops(device: torch.device) -> bool:
    """Return whether compiled loops can be used: they run on the CPU only."""
    return device.type == "cpu" and has_compiler()
