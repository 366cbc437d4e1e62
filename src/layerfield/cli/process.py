"""How the program runs and ends: signals, errors as one line, the exit status."""

import io
import os
import re
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import NoReturn

import typer

from layerfield.cli.terminal import complain
from layerfield.memory import keep_large_blocks

_NO_MEMORY = re.compile("out of memory|allocate memory")  # of PyTorch's RuntimeErrors
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def run(app: typer.Typer) -> NoReturn:
    """Run the command line; anything wrong is one line on standard error and exit status 2."""
    _prepare()
    try:
        status = app(standalone_mode=False)
    except (_Interrupted, typer.Abort):
        _fail("interrupted; nothing is half-written")
    except (ValueError, OSError) as error:
        _fail(str(error))
    except Exception as error:
        _fail(_expected(error))
    sys.exit(status)


class _Interrupted(BaseException):
    """A signal asked to stop. Typer would turn a KeyboardInterrupt into an exit of its own."""


@contextmanager
def until_interrupted() -> Iterator[None]:
    """Let a signal end what would go on for ever; that is no error."""
    with suppress(_Interrupted):
        yield


def _prepare() -> None:
    keep_large_blocks()
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as under nohup
            signal.signal(number, _interrupt)
    if isinstance(sys.stdout, io.TextIOWrapper):  # file names may hold what it cannot print
        sys.stdout.reconfigure(errors="backslashreplace")


def _interrupt(*_: object) -> NoReturn:
    for number in _SIGNALS:  # a second one must not disturb the cleaning up
        signal.signal(number, signal.SIG_IGN)
    raise _Interrupted


def _expected(error: Exception) -> str:
    """Return the line for errors that are not ValueErrors; raise those that nobody expects."""
    if isinstance(error, MemoryError) or _NO_MEMORY.search(str(error)):
        return "out of memory; take fewer or smaller views (--views, --step, --scale, --crop)"
    # Usage errors of click, whichever copy of click this typer brings along.
    usage = getattr(error, "format_message", None)
    if usage is None:
        raise error
    return usage() or "no command given; see layerfield --help"


def _fail(message: str) -> NoReturn:
    line = " ".join(message.split())
    complain(f"layerfield: {line}")
    _give_up_output()
    sys.exit(2)


def _give_up_output() -> None:
    """What standard output cannot take would be tried, and complained of, again at the exit."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
