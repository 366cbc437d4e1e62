"""Peak memory of a method, in a process that does nothing else.

`ru_maxrss` will not do: on Linux a process starts with that of the one that started it, and a large
parent hides what a small method takes. `VmHWM` begins anew with the program.
"""

import multiprocessing
import signal
from multiprocessing.connection import Connection
from pathlib import Path

from torch import Tensor

from layerfield.display import Display
from layerfield.display_spec import Spec
from layerfield.light_field import LightField
from layerfield.synthesizer import synthesize

_STATUS = Path("/proc/self/status")


def peak_memory(
    method: str, iterations: int | None, field: LightField, display: Display
) -> float | None:
    """Return megabytes, the interpreter and its libraries included; None where there is no /proc.

    Raises:
        MemoryError: the process was killed.
    """
    if not _STATUS.is_file():
        return None
    context = multiprocessing.get_context("spawn")
    answers, answer = context.Pipe(duplex=False)
    job = (answer, method, iterations, field.views, field.grid, display.spec)
    process = context.Process(target=_send, args=job, daemon=True)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()  # the process inherits the mask, so that only we answer Ctrl-C
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
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
    answer: Connection,
    method: str,
    iterations: int | None,
    views: Tensor,
    grid: tuple[int, int],
    spec: Spec,
) -> None:
    try:
        synthesize(LightField(views, grid), Display(spec), method=method, iterations=iterations)
        answer.send(_peak_megabytes())
    except Exception as error:
        answer.send(error)


def _peak_megabytes() -> float:
    lines = _STATUS.read_text("utf-8").splitlines()
    (peak,) = (line.split()[1] for line in lines if line.startswith("VmHWM"))
    return int(peak) / 1024
