"""A map prepared for alignment, either at once or when the first query needs it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

import torch

from objconnect.localization.featuremetric.global_search import GlobalSearch
from objconnect.localization.featuremetric.refiner import Refiner
from objconnect.localization.featuremetric.tracking import Tracking
from objconnect.scene.errors import InputError, PreparationError
from objconnect.scene.localizer import Stopwatch


@dataclass(frozen=True)
class MapState:
    """The parts of a localizer that are prepared for a map.

    Attributes:
        refine: refines an initial pose of any image.
        search: localizes images with an incomplete prior.
        tracking: aligns images of a sequence from their predicted pose; None if switched off.
    """

    refine: Refiner
    search: GlobalSearch
    tracking: Tracking | None


class Preparation:
    """Prepares a map for alignment, once. Threads may share it."""

    def __init__(self, prepare: Callable[[], MapState]) -> None:
        self._prepare = prepare
        self._done: MapState | None = None
        self._lock = Lock()

    def __call__(self) -> MapState:
        """Return the prepared map; the first call prepares it."""
        with self._lock:
            if self._done is None:
                # A query runs in inference mode. Tensors made there cannot be used outside of it.
                with torch.inference_mode(False):
                    self._done = self._prepare()
            return self._done

    def prepare_for_query(self, clock: Stopwatch) -> MapState:
        """Return the prepared map; the time that a query waits for it is the stage ``preparation``.

        Raises:
            InputError: a photograph of the map is missing, damaged or changed meanwhile.
            PreparationError: any other error, which every query would raise again.
        """
        if self._done is not None:
            return self._done
        with clock.stage("preparation"):
            try:
                return self()
            except InputError:
                raise
            except Exception as error:
                reason = f"the map could not be prepared: {type(error).__name__}: {error}"
                raise PreparationError(reason) from error
