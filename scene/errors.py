"""The one exception a person is meant to read."""


class InputError(ValueError):
    """Input or environment at fault; the message says in one line what, where and what to do.

    The command line prints the message alone, without a traceback, and exits with code 2.
    """
