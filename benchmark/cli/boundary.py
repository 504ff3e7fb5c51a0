"""The boundary between a command and the shell: every error becomes one line and an exit code.

Other programs rely on the exit codes. 1 means that recall dropped since a baseline, or that wrong
answers became more frequent; no error ends with 1.
"""

from __future__ import annotations

import csv
import errno
import logging
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, Final

from typer.core import TyperGroup

from benchmark.cli.stray_words import refuse_stray_settings, refuse_taken_options
from objconnect.scene.errors import InputError
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.runtime.script import INPUT_AT_FAULT as INPUT_AT_FAULT

REGRESSION: Final = 1
PROGRAM_AT_FAULT: Final = 3
# Shells report a process that a signal ended as 128 plus the number of the signal.
_SIGNAL_BASE: Final = 128
_CLOSED_PIPE: Final = _SIGNAL_BASE + 13  # SIGPIPE

# Exceptions of libraries on input that they cannot process, besides InputError.
_INPUT_ERRORS: Final = (
    OSError,
    UnicodeError,
    OverflowError,
    MemoryError,
    csv.Error,
    RecursionError,
)
# Longer error messages are cut, because they may quote a long argument.
_MAX_CHARACTERS: Final = 1000


class Terminated(KeyboardInterrupt):
    """Raised on a signal that ends the process, so that it cleans up as after Ctrl-C."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


class _StoppedError(Exception):
    """Ctrl-C or a signal, as an exception that typer passes on, unlike KeyboardInterrupt."""

    def __init__(self, cause: KeyboardInterrupt) -> None:
        super().__init__()
        self.number = cause.number if isinstance(cause, Terminated) else signal.SIGINT


class Boundary(TyperGroup):
    """A group of commands that reports every error as one line and an exit code."""

    def invoke(self, ctx: Any) -> Any:
        """See ``TyperGroup.invoke``."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as error:
            raise _StoppedError(error) from None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """See ``TyperGroup.resolve_command``; also refuses words that click would misread."""
        resolved = super().resolve_command(ctx, args)
        _, command, words = resolved
        if command is not None:
            refuse_taken_options(command, words)
            refuse_stray_settings(command, words)
        return resolved

    def main(self, *args: Any, **extra: Any) -> Any:
        """Run a command and end the process with its exit code; never returns."""
        _open_standard_streams()
        _never_fail_to_print()
        # Without standalone mode, typer raises errors instead of printing them on several lines.
        extra["standalone_mode"] = False
        with _end_like_ctrl_c():
            sys.exit(_run_command(lambda: super(Boundary, self).main(*args, **extra)))


def _run_command(run: Callable[[], Any]) -> int:
    """Run a command, print its error on standard error, and return the exit code."""
    try:
        code = run()
        # A full disk must be noticed here, not when the interpreter flushes at its end.
        if sys.stdout is not None:
            sys.stdout.flush()
    except InputError as error:
        return _print_error(str(error), INPUT_AT_FAULT)
    except _StoppedError as stopped:
        word = "interrupted" if stopped.number == signal.SIGINT else "terminated"
        return _print_error(word, _SIGNAL_BASE + stopped.number)
    except (BrokenPipeError, SystemExit):  # typer ends the process when it meets a closed pipe
        return _abandon_output(_CLOSED_PIPE)
    except _INPUT_ERRORS as error:
        return _print_error(_describe(error), INPUT_AT_FAULT)
    except Exception as error:
        if _is_cyclic_link(error):
            return _print_error(f"{error}: a symbolic link leads to itself", INPUT_AT_FAULT)
        if type(error).__name__ == "NoArgsIsHelpError":
            print(error.format_message(), file=sys.stderr)  # type: ignore[attr-defined]
            return INPUT_AT_FAULT
        if _is_usage_error(error):
            return _print_error(_describe_usage(error), INPUT_AT_FAULT)
        traceback.print_exc()
        return _print_error(f"{_describe(error)}: this is a fault of the program", PROGRAM_AT_FAULT)
    return code if isinstance(code, int) else 0


def _print_error(message: str, code: int) -> int:
    """Print one line on standard error and return the exit code."""
    prefix = "error: " if code in (INPUT_AT_FAULT, PROGRAM_AT_FAULT) else ""
    with suppress(OSError, ValueError):  # standard error is closed or full
        print(f"objconnect: {prefix}{_one_line(message)}", file=sys.stderr)
    return _abandon_output(code)


def _one_line(message: str) -> str:
    """Return a message as one printable line; a long one is cut in the middle."""
    line = for_terminal(" ".join(message.split()))
    half = _MAX_CHARACTERS // 2
    return line if len(line) <= _MAX_CHARACTERS else f"{line[:half]} ... {line[-half:]}"


def _abandon_output(code: int) -> int:
    """Flush standard output, or discard what cannot be written, and return the exit code.

    The interpreter would otherwise report a failed flush at its end.
    """
    try:
        if sys.stdout is not None:  # None where it was closed before the start
            sys.stdout.flush()
    except (OSError, ValueError):
        with suppress(OSError, ValueError, AttributeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return code


def _describe(error: BaseException) -> str:
    """Return the message of an exception other than ``InputError``."""
    if isinstance(error, OSError) and error.strerror:
        if error.errno == errno.ENOSPC and not error.filename:
            return "cannot write: the disk is full"
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    if isinstance(error, MemoryError):
        return "there is not enough memory: give less at a time or smaller sizes"
    return f"{type(error).__name__}: {error}"


def _is_cyclic_link(error: Exception) -> bool:
    """Return whether ``Path.resolve`` met a cyclic link; from Python 3.13 on it is an OSError."""
    return isinstance(error, RuntimeError) and str(error).startswith("Symlink loop")


def _is_usage_error(error: Exception) -> bool:
    """Return whether the command line is at fault.

    The class is compared by name, because typer uses its own copy of click or the installed one.
    """
    return any(kind.__name__ == "ClickException" for kind in type(error).__mro__)


def _describe_usage(error: Any) -> str:
    """Return the message of click, followed by the command that prints the help."""
    message: str = error.format_message()
    context = getattr(error, "ctx", None)
    return message if context is None else f"{message} See '{context.command_path} --help'."


def _open_standard_streams() -> None:
    """Open closed standard streams as the null device.

    Otherwise the next file that is opened gets the number of the stream, and the output of
    libraries is written to it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free


def _never_fail_to_print() -> None:
    """Print characters that the terminal cannot show as escapes instead of raising an error."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):
            stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]


@contextmanager
def _end_like_ctrl_c() -> Iterator[None]:
    """Raise ``Terminated`` on SIGTERM and SIGHUP, unless they are ignored as under nohup."""

    def end(number: int, frame: FrameType | None) -> None:
        raise Terminated(number)

    previous = {}
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            with suppress(ValueError):  # not in the main thread
                previous[number] = signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


class PrintedFormatter(logging.Formatter):
    """Formats log messages as one printable line each, whatever names they contain."""

    def format(self, record: logging.LogRecord) -> str:
        """See ``logging.Formatter``."""
        return for_terminal(f"{record.levelname}: {record.getMessage()}")
