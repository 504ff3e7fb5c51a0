"""The exceptions whose message a person is meant to read."""

from typing import Final


class InputError(ValueError):
    """Input or environment is at fault; the message says in one line what, where and what to do.

    The command line prints the message alone, without a traceback, and exits with code 2.
    """


class WriteError(InputError):
    """A place cannot be written or has no space left; what is finished there stays usable."""


class PreparationError(Exception):
    """What a query needed of the map could not be made, through no fault of the input.

    No other query could be localized either, so it is no failure of one.
    """


# h5py has no exception of its own: these are what reading a damaged file may raise.
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
