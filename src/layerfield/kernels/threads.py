"""Tasks divided among the threads that PyTorch computes with."""

import ctypes
import math
import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import torch

_Work = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
_PROCESS = os.getpid()
_SPANS = 4  # for every thread: who is held up by others leaves some
_FEW = 1 << 19


def in_threads(task: Callable[[int], None], count: int) -> None:
    """Call a task with 0 .. count - 1, each once and in no order; return when all are done.

    Tasks have to release the interpreter's lock to run side by side. Whoever is free takes the next
    one, so that a thread whose core others use holds nobody up. Of an interrupted call, or when a
    task has raised something, nothing more is begun.
    """
    left, raised = deque(range(count)), list[BaseException]()

    def work(_: int | None = None) -> None:
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

    threads = torch.get_num_threads()
    if min(threads, count) < 2:
        work()
    elif (parallel := _openmp()) is not None and os.getpid() == _PROCESS:
        parallel(_Work(work), None, threads, 0)
    else:
        helpers = [_pool(os.getpid()).submit(work) for _ in range(min(threads, count) - 1)]
        work()
        for each in helpers:
            if not each.cancel():
                each.result()
    if raised:
        raise raised[0]


def in_spans(task: Callable[[int, int], None], count: int, numbers: int) -> None:
    """Call a task with spans, from and to, that come to 0 .. count; a few for every thread.

    What it does for one of them must not depend on how they were divided.

    Args:
        task: as that of `in_threads`.
        count: of what is divided.
        numbers: that are gone over in all. Where they are few, threads cost more than they bring.
    """
    if numbers < _FEW:
        return task(0, count)
    length = max(1, math.ceil(count / (_SPANS * torch.get_num_threads())))

    def span(number: int) -> None:
        task(number * length, min(count, (number + 1) * length))

    return in_threads(span, math.ceil(count / length))


@cache
def _openmp() -> Callable[..., None] | None:
    """Return what makes PyTorch's threads call a function, or None where they are not GNU OpenMP's.

    Threads of OpenMP that have nothing to do go round and round for a while, for the next loop to
    find them awake. Others beside them would have to share their cores: a pass over layers took two
    or three times as long behind one of PyTorch's.
    """
    try:
        parallel = ctypes.CDLL(None).GOMP_parallel
    except (AttributeError, OSError, TypeError):
        return None
    parallel.argtypes = (_Work, ctypes.c_void_p, ctypes.c_uint, ctypes.c_uint)
    parallel.restype = None
    return parallel


@cache
def _pool(process: int) -> ThreadPoolExecutor:  # a forked process has none of its parent's threads
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix=f"layerfield-{process}")
