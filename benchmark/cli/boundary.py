"""Between a command and the shell: every fault becomes one line and an exit code.

The exit codes are a promise: 1 says that recall dropped, and nothing else does.
"""

from __future__ import annotations

import csv
import errno
import logging
import os
import signal
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, Final

from typer.core import TyperGroup

from scene.errors import InputError
from scene.runtime.printed import printed

REGRESSION: Final = 1
INPUT_AT_FAULT: Final = 2
PROGRAM_AT_FAULT: Final = 3
# What shells call a process that a signal ended.
_SIGNALLED: Final = 128
_CLOSED_PIPE: Final = _SIGNALLED + 13

# What the libraries below raise on input that they cannot take, besides our own errors.
_FAULTS: Final = (OSError, UnicodeError, OverflowError, MemoryError, csv.Error, RecursionError)
# Of a message, characters: an argument may be as long as it likes.
_LONGEST: Final = 1000


class Terminated(KeyboardInterrupt):
    """A signal that asks the process to end; everything cleans up as after Ctrl-C."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


class _StoppedError(Exception):
    """Ctrl-C or a signal, past typer, which knows one exit code for both."""

    def __init__(self, cause: KeyboardInterrupt) -> None:
        super().__init__()
        self.number = cause.number if isinstance(cause, Terminated) else signal.SIGINT


class Boundary(TyperGroup):
    """A group of commands behind the boundary."""

    def invoke(self, ctx: Any) -> Any:
        """See ``TyperGroup.invoke``."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as error:
            raise _StoppedError(error) from None

    def main(self, *args: Any, **extra: Any) -> Any:
        """Run a command and end the process with its exit code; never returns."""
        _open_standard_streams()
        _never_fail_to_print()
        # Errors come here instead of being printed over several lines.
        extra["standalone_mode"] = False
        with _ended_like_ctrl_c():
            sys.exit(_code(lambda: super(Boundary, self).main(*args, **extra)))


def _code(run: Any) -> int:
    """Exit code of a command; what is to be said is said."""
    try:
        code = run()
        # Here, since the interpreter would flush after us, and answer a full disk by itself.
        if sys.stdout is not None:
            sys.stdout.flush()
    except InputError as error:
        return _say(str(error), INPUT_AT_FAULT)
    except _StoppedError as stopped:
        word = "interrupted" if stopped.number == signal.SIGINT else "terminated"
        return _say(word, _SIGNALLED + stopped.number)
    except (BrokenPipeError, SystemExit):  # typer ends the process when it meets a closed pipe
        return _quietly(_CLOSED_PIPE)
    except _FAULTS as error:
        return _say(_words(error), INPUT_AT_FAULT)
    except Exception as error:
        if _is_cyclic_link(error):
            return _say(f"{error}: a symbolic link leads to itself", INPUT_AT_FAULT)
        if type(error).__name__ == "NoArgsIsHelpError":
            print(error.format_message(), file=sys.stderr)  # type: ignore[attr-defined]
            return INPUT_AT_FAULT
        if _is_usage(error):
            return _say(_usage(error), INPUT_AT_FAULT)
        traceback.print_exc()
        return _say(f"{_words(error)}: this is a fault of the program", PROGRAM_AT_FAULT)
    return code if isinstance(code, int) else 0


def _say(message: str, code: int) -> int:
    """One line on standard error."""
    with suppress(OSError, ValueError):  # nobody listens
        print(f"objconnect: {_level(code)}{_one_line(message)}", file=sys.stderr)
    return _quietly(code)


def _one_line(message: str) -> str:
    """What a terminal can show; of a long message its beginning and its end."""
    line = printed(" ".join(message.split()))
    half = _LONGEST // 2
    return line if len(line) <= _LONGEST else f"{line[:half]} ... {line[-half:]}"


def _level(code: int) -> str:
    return "error: " if code in (INPUT_AT_FAULT, PROGRAM_AT_FAULT) else ""


def _quietly(code: int) -> int:
    """What standard output still holds goes nowhere when it cannot be written: the interpreter
    would complain about it at its end."""
    try:
        if sys.stdout is not None:  # closed before we began
            sys.stdout.flush()
    except (OSError, ValueError):
        with suppress(OSError, ValueError, AttributeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return code


def _words(error: BaseException) -> str:
    """An exception of a library, as a sentence about the input."""
    if isinstance(error, OSError) and error.strerror:
        if error.errno == errno.ENOSPC and not error.filename:
            return "cannot write: the disk is full"
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    if isinstance(error, MemoryError):
        return "there is not enough memory: give less at a time or smaller sizes"
    return f"{type(error).__name__}: {error}"


def _is_cyclic_link(error: Exception) -> bool:
    """What ``Path.resolve`` says of one, until Python 3.13 made it an OSError."""
    return isinstance(error, RuntimeError) and str(error).startswith("Symlink loop")


def _is_usage(error: Exception) -> bool:
    """Whether the words of the command line are at fault: typer has a click of its own, or uses
    the installed one."""
    return any(kind.__name__ == "ClickException" for kind in type(error).__mro__)


def _usage(error: Any) -> str:
    message: str = error.format_message()
    context = getattr(error, "ctx", None)
    return message if context is None else f"{message} See '{context.command_path} --help'."


def _open_standard_streams() -> None:
    """A stream that was closed before we began leads nowhere: else the next file to be opened had
    its number, and what libraries print went there."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free


def _never_fail_to_print() -> None:
    """A terminal that knows ASCII alone is shown escapes instead of an error."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):
            stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]


@contextmanager
def _ended_like_ctrl_c() -> Iterator[None]:
    """SIGTERM and SIGHUP raise ``Terminated`` during the block, unless they are ignored (nohup)."""

    def end(number: int, frame: FrameType | None) -> None:
        raise Terminated(number)

    before = {}
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows knows one of them
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            with suppress(ValueError):  # not in the main thread
                before[number] = signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class PrintedFormatter(logging.Formatter):
    """Log messages of one line each, whatever names are in them."""

    def format(self, record: logging.LogRecord) -> str:
        """See ``logging.Formatter``."""
        return printed(f"{record.levelname}: {record.getMessage()}")
