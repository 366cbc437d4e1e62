"""Seconds of a run: median of several after a warm-up, the device waited for."""

import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import torch

from layerfield.solve import Clock

Made = TypeVar("Made")

_ENOUGH = 0.5  # seconds of all runs


@dataclass(frozen=True)
class Seconds:
    """How long runs took.

    Args:
        median: of all of them, seconds.
        fastest: of them.
        slowest: of them.
        runs: their number.
    """

    median: float
    fastest: float
    slowest: float
    runs: int

    @classmethod
    def of(cls, times: Sequence[float]) -> "Seconds":
        """Summarise times.

        >>> Seconds.of([3.0, 1.0, 2.0])
        Seconds(median=2.0, fastest=1.0, slowest=3.0, runs=3)
        """
        return cls(statistics.median(times), min(times), max(times), len(times))


def once(run: Callable[[], Made], device: torch.device) -> tuple[float, Made]:
    """Return the seconds of one run, and what it made."""
    clock = Clock(device)
    with clock:
        made = run()
    return clock.seconds, made


def timed(
    run: Callable[[], Made], device: torch.device, *, repeats: int, cap: float = math.inf
) -> tuple[Seconds, Made]:
    """Return the seconds of several runs after a warm-up, and what the warm-up made.

    Of short ones there are more: whatever else a machine does for a moment would be most of three
    runs of 20 ms.

    Args:
        run: what to time.
        device: that it runs on.
        repeats: runs that count, at least; they go on for half a second, or up to the square of it.
        cap: a warm-up of more than so many seconds is the only run, and counts.
    """
    first, made = once(run, device)
    if first > cap:
        return Seconds.of([first]), made
    times = list[float]()
    while len(times) < repeats or (sum(times) < _ENOUGH and len(times) < repeats**2):
        times.append(once(run, device)[0])
    return Seconds.of(times), made
