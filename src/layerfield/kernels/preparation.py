"""What loops need before they run: compiled once on a machine, read from disk once in a process.

Clocks leave it out: where a run takes milliseconds, the first of a new installation takes a minute.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache


class Preparation(threading.local):
    """Seconds that a thread has spent on it so far.

    Attributes:
        seconds: those that are over.
        tell: called with True before something is compiled that no earlier process has left, and
            with False afterwards.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self.tell: Callable[[bool], None] = lambda _: None
        self._depth, self._began = 0, 0.0

    def begin(self) -> None:
        """Begin, perhaps inside of another one."""
        if self._depth == 0:
            self._began = time.perf_counter()
        self._depth += 1

    def end(self) -> None:
        """End what was begun."""
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._began

    @contextmanager
    def going_on(self) -> Iterator[None]:
        """Count what is inside a `with`."""
        self.begin()
        try:
            yield
        finally:
            self.end()

    @contextmanager
    def told(self, tell: Callable[[bool], None]) -> Iterator[None]:
        """Have something called, inside a `with`, whenever this thread compiles."""
        before, self.tell = self.tell, tell
        try:
            yield
        finally:
            self.tell = before


PREPARATION = Preparation()


@cache
def listen_to_compiler() -> None:
    """Count what Numba compiles; it is imported here."""
    from numba.core import event  # noqa: PLC0415

    class Compiling(event.Listener):
        def on_start(self, event: event.Event) -> None:
            PREPARATION.begin()
            PREPARATION.tell(True)

        def on_end(self, event: event.Event) -> None:
            PREPARATION.end()
            PREPARATION.tell(False)

    event.register("numba:compile", Compiling())
