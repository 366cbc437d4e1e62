"""Work in a process of its own, whose peak memory is that of the work."""

import multiprocessing
import resource
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from typing import ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Answer = TypeVar("Answer")

_STATUS = Path("/proc/self/status")  # of Linux


def in_own_process(
    work: Callable[Arguments, Answer], *args: Arguments.args, **kwargs: Arguments.kwargs
) -> Answer:
    """Return what a function says in a new process; raise what it raises there.

    In a script this needs the usual `if __name__ == "__main__":`.

    Args:
        work: a function of a module, which can be found there by its name.
        *args: its arguments.
        **kwargs: its arguments.

    Raises:
        MemoryError: the process was killed.
    """
    context = multiprocessing.get_context("spawn")
    answers, answer = context.Pipe(duplex=False)
    process = context.Process(target=_send, args=(answer, work, args, kwargs), daemon=True)
    resource_tracker.ensure_running()  # started by start(), it would let interrupts through again
    with _interrupts_held_back():  # the process inherits this, so that only we answer Ctrl-C
        process.start()
    answer.close()
    try:
        found = answers.recv()
    except EOFError:
        raise MemoryError from None  # nothing else kills a process silently
    finally:
        process.kill()
        process.join()
    if isinstance(found, Exception):
        raise found
    return found


def _send(
    answer: Connection, work: Callable[..., object], args: tuple[object, ...], kwargs: dict
) -> None:
    try:
        answer.send(work(*args, **kwargs))
    except Exception as error:
        answer.send(error)


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def peak_megabytes() -> float:
    """Return the peak memory of this process, the interpreter and its libraries included.

    Linux hands `ru_maxrss` on to the processes that one starts: a large parent would hide what a
    small child takes. `VmHWM` begins anew with the program.
    """
    if _STATUS.is_file():
        lines = _STATUS.read_text("utf-8").splitlines()
        (peak,) = (line.split()[1] for line in lines if line.startswith("VmHWM"))
        return int(peak) / 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024**2 if sys.platform == "darwin" else 1024)
