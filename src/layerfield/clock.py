"""Seconds of what is done on a processor or an accelerator."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import torch

from layerfield.kernels.preparation import PREPARATION

_WAITS = ContextVar("waits", default=True)  # a clock, for an accelerator


@contextmanager
def without_waiting() -> Iterator[None]:
    """Let an accelerator work on one picture while the next is prepared, inside a `with`.

    What is measured then, as `Solution.seconds`, ends when all is on its way, not when it is done.
    """
    before = _WAITS.set(False)
    try:
        yield
    finally:
        _WAITS.reset(before)


class Clock:
    """Adds up the time spent inside it; waits for the accelerator where there is one.

    Inside itself it neither waits nor counts. What loops need before their first run is left out;
    see `layerfield.kernels.preparation`.
    """

    def __init__(self, device: torch.device) -> None:
        self.seconds = 0.0
        self._device = device
        self._entered = 0.0
        self._depth = 0

    def __enter__(self) -> None:
        if self._depth == 0:
            self._entered = self._now()
        self._depth += 1

    def __exit__(self, *exception: object) -> None:
        self._depth -= 1
        if self._depth == 0:
            self.seconds += self._now() - self._entered

    def _now(self) -> float:
        if self._device.type == "cuda" and _WAITS.get():
            torch.cuda.synchronize(self._device)
        return time.perf_counter() - PREPARATION.seconds
