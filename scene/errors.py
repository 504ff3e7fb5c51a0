"""The one exception a person is meant to read, and those it stands for."""

from typing import Final


class InputError(ValueError):
    """Input or environment at fault; the message says in one line what, where and what to do.

    The command line prints the message alone, without a traceback, and exits with code 2.
    """


class WriteError(InputError):
    """A place that cannot be written, or has no room left; what is finished there stays of use."""


# What reading a damaged HDF5 file may raise: h5py has no exception of its own.
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
