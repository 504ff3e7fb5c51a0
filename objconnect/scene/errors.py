"""Exceptions whose message is written for the user."""

from typing import Final


class InputError(ValueError):
    """The input or the environment is wrong; the one-line message says what, where, what to do.

    The command line prints the message alone, without a traceback, and exits with code 2.
    """


class WriteError(InputError):
    """A path cannot be written or its disk is full; results that are finished stay usable."""


class NoPointsError(InputError):
    """Photographs show too little texture, or overlap too little, for any point of a map."""


class PreparationError(Exception):
    """The per-map state that a query needs could not be built, although the input is right.

    It concerns every query of the run, so no single query is reported as failed.
    """


# h5py has no exception class of its own: reading a damaged file may raise any of these.
HDF5_DAMAGE: Final = (
    AttributeError,
    IndexError,
    KeyError,
    MemoryError,
    OSError,
    OverflowError,
    RuntimeError,
    TypeError,
    ValueError,
)
