"""Tasks divided among as many threads as PyTorch takes."""

import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import torch


def in_threads(task: Callable[[int], None], count: int) -> None:
    """Call a task with 0 .. count - 1, each once and in no order; return when all are done.

    Tasks have to release the interpreter's lock to run side by side. Whoever is free takes the next
    one, so that a thread whose core others use holds nobody up.
    """
    left = deque(range(count))

    def work() -> None:
        while True:
            try:
                number = left.popleft()
            except IndexError:
                return
            task(number)

    helpers = min(torch.get_num_threads(), count) - 1
    waiting = [_pool(os.getpid()).submit(work) for _ in range(helpers)]
    try:
        work()
    finally:
        left.clear()  # of an interrupted call nothing more is begun
    for each in waiting:
        if not each.cancel():
            each.result()


@cache
def _pool(process: int) -> ThreadPoolExecutor:  # a forked process has none of its parent's threads
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix=f"layerfield-{process}")
