"""Methods by name: those of the baselines, and the object-connect network."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Final

import baselines.registry as others
from scene.errors import InputError

if TYPE_CHECKING:
    from baselines.training.config import TrainConfig
    from baselines.training.loop import Trainable

_NAME: Final = "objconnect"
TRAINABLE: Final = (*others.TRAINABLE, _NAME)


def trainable(name: str) -> Callable[[TrainConfig], Trainable]:
    """A method that learns, still to be given the configuration of its training.

    Raises:
        InputError: no such method, or one without anything to learn.
    """
    if name == _NAME:
        from objconnect.training import ObjConnectTraining

        return ObjConnectTraining
    if name not in TRAINABLE:
        can = ", ".join(TRAINABLE)
        raise InputError(f"method {name!r} cannot be trained; those that can: {can}")
    return others.trainable(name)
