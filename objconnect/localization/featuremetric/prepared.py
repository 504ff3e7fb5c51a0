"""What alignment needs of a map, which may be made when the first query asks for it."""

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
class Prepared:
    """What alignment needs of a map.

    Attributes:
        refine: refines starts.
        search: looks for the pose of an image of which no prior says all.
        tracking: follows images of a sequence; None where none is followed.
    """

    refine: Refiner
    search: GlobalSearch
    tracking: Tracking | None


class Preparation:
    """Prepares a map for alignment, once. Threads may share it.

    Args:
        prepare: does it.
    """

    def __init__(self, prepare: Callable[[], Prepared]) -> None:
        self._prepare = prepare
        self._done: Prepared | None = None
        self._lock = Lock()

    def __call__(self) -> Prepared:
        """Return what is prepared, as the thread that is first finds it."""
        with self._lock:
            if self._done is None:
                # A query runs in the mode of inference, whose tensors serve nothing else.
                with torch.inference_mode(False):
                    self._done = self._prepare()
            return self._done

    def in_query(self, clock: Stopwatch) -> Prepared:
        """Return what is prepared; the time that a query waits for it is a stage of its own.

        Raises:
            InputError: a photograph of the map is missing, damaged or changed meanwhile.
            PreparationError: anything else went wrong, which would for any other query.
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
