"""Peak memory of a method, in a process that does nothing else."""

import multiprocessing
import signal
from multiprocessing.connection import Connection

from torch import Tensor

from layerfield.display import Display
from layerfield.display_spec import Spec
from layerfield.evaluate import peak_megabytes
from layerfield.light_field import LightField
from layerfield.synthesizer import synthesize


def peak_memory(method: str, iterations: int | None, field: LightField, display: Display) -> float:
    """Return megabytes, the interpreter and its libraries included.

    Raises:
        MemoryError: the process was killed.
    """
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
        answer.send(peak_megabytes())
    except Exception as error:
        answer.send(error)
