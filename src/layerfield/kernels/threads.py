"""The threads that PyTorch computes with, and others where those are not to be had."""

import ctypes
import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import torch

FEW = 1 << 16  # numbers for which threads cost more than they bring
SPANS = 4  # for every thread: who is held up by others leaves some
_PROCESS = os.getpid()


def parallel_address() -> int | None:
    """Return where `GOMP_parallel` is, which has PyTorch's threads call a function.

    Threads of OpenMP that have nothing to do go round and round for a while, for the next loop to
    find them awake. Others beside them would have to share their cores: a pass over layers took two
    or three times as long behind one of PyTorch's.

    None where PyTorch's threads are not GNU OpenMP's, and in forked processes, which have none of
    their parent's.
    """
    return _address() if os.getpid() == _PROCESS else None


@cache
def _address() -> int | None:
    try:
        return ctypes.cast(ctypes.CDLL(None).GOMP_parallel, ctypes.c_void_p).value
    except (AttributeError, OSError, TypeError):
        return None


def in_threads(task: Callable[[int], None], count: int) -> None:
    """Call a task with 0 .. count - 1, each once and in no order; return when all are done.

    Tasks have to release the interpreter's lock to run side by side. Whoever is free takes the next
    one, so that a thread whose core others use holds nobody up. Of an interrupted call, or when a
    task has raised something, nothing more is begun.
    """
    left, raised = deque(range(count)), list[BaseException]()

    def work() -> None:
        try:
            while True:
                try:
                    number = left.popleft()
                except IndexError:
                    return
                task(number)
        except BaseException as error:
            left.clear()
            raised.append(error)

    pool = _pool(os.getpid())
    helpers = [pool.submit(work) for _ in range(min(torch.get_num_threads(), count) - 1)]
    work()
    for each in helpers:
        if not each.cancel():
            each.result()
    if raised:
        raise raised[0]


@cache
def _pool(process: int) -> ThreadPoolExecutor:  # a forked process has none of its parent's threads
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix=f"layerfield-{process}")
