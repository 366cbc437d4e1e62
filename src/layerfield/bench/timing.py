"""Seconds of a run: median of several after a warm-up, the device waited for."""

import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import torch

from layerfield.clock import Clock

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
    while not _suffice(times, repeats):
        times.append(once(run, device)[0])
    return Seconds.of(times), made


def timed_by_turns(
    run: Callable[[], object],
    other: Callable[[], object],
    device: torch.device,
    *,
    repeats: int,
    cap: float = math.inf,
) -> tuple[Seconds, float]:
    """Return the seconds of a run as `timed` does, and how many times those of another they are.

    Both run by turns, and the ratio is the median of those of neighbours: machines become slower
    and faster by a third within minutes, which between two runs that follow each other matters
    little.

    Args:
        run: what to time.
        other: what to compare it with.
        device: that both run on.
        repeats: as of `timed`.
        cap: as of `timed`; then the warm-ups of both are compared.
    """
    before, first = once(other, device)[0], once(run, device)[0]
    if first > cap:
        return Seconds.of([first]), first / before
    pairs = list[tuple[float, float]]()
    while not _suffice([own for own, _ in pairs], repeats):
        others = once(other, device)[0]
        pairs.append((once(run, device)[0], others))
    ratio = statistics.median(own / others for own, others in pairs)
    return Seconds.of([own for own, _ in pairs]), ratio


def _suffice(times: Sequence[float], repeats: int) -> bool:
    return len(times) >= repeats and (sum(times) >= _ENOUGH or len(times) >= repeats**2)
