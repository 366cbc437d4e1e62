"""What rows come to over light fields: a line for each display, method and number of iterations."""

import statistics
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from layerfield.bench.rows import BenchRow
from layerfield.metrics import EXACT, decibels
from layerfield.synthesizer import spelled


@dataclass(frozen=True)
class Standing:
    """One method with one number of iterations, over all light fields of a display.

    Args:
        display: name.
        method: title.
        iterations: that were asked for.
        psnr: mean of the 8-bit panels, dB of light.
        below: mean of the reference's PSNR less that, dB.
        excess_median: of the excess error of 8-bit panels.
        excess_worst: the largest, and
        worst_field: where.
        unrounded_median: as the median, before rounding.
        unrounded_worst: as the largest, before rounding.
        seconds: mean of the fields' medians.
        operations_per_pixel: mean, for every pixel of a view and colour channel.
        over_transforms: seconds over those of the Fourier transforms alone, mean; None if there
            are none.
        peak_mb: the largest, if measured.
        capped: on one field at least it took longer than the cap.
    """

    display: str
    method: str
    iterations: int
    psnr: float
    below: float
    excess_median: float
    excess_worst: float
    worst_field: str
    unrounded_median: float
    unrounded_worst: float
    seconds: float
    operations_per_pixel: float
    over_transforms: float | None
    peak_mb: float | None
    capped: bool

    @property
    def label(self) -> str:
        """The method and its iterations."""
        return spelled(self.method, self.iterations)

    def as_record(self) -> dict[str, Any]:
        """Return the line as plain data for JSON."""
        return asdict(self)


def standings(rows: Sequence[BenchRow]) -> list[Standing]:
    """Return the lines of all that was measured on every light field of its display.

    What a cap kept from some light fields has no line: a mean over others says nothing beside it.
    """
    fields = {(row.display, row.field) for row in rows}
    groups: dict[tuple[str, str, int], list[BenchRow]] = {}
    for row in rows:
        groups.setdefault((row.display, row.method, row.iterations), []).append(row)
    return [
        _standing(group)
        for (display, _, _), group in groups.items()
        if len(group) == sum(name == display for name, _ in fields)
    ]


def _standing(rows: Sequence[BenchRow]) -> Standing:
    worst = max(rows, key=lambda row: row.excess)
    reached = [_decibels(row.mean_square_error) for row in rows]
    best = [_decibels(row.yardstick.mean_square_error) for row in rows]
    transforms = [row.transform_seconds for row in rows if row.transform_seconds is not None]
    seconds = statistics.mean(row.seconds.median for row in rows)
    peaks = [row.peak_mb for row in rows if row.peak_mb is not None]
    return Standing(
        display=worst.display,
        method=worst.method,
        iterations=worst.iterations,
        psnr=statistics.mean(reached),
        below=statistics.mean(best) - statistics.mean(reached),
        excess_median=statistics.median(row.excess for row in rows),
        excess_worst=worst.excess,
        worst_field=worst.field,
        unrounded_median=statistics.median(row.excess_unrounded for row in rows),
        unrounded_worst=max(row.excess_unrounded for row in rows),
        seconds=seconds,
        operations_per_pixel=statistics.mean(row.operations_per_pixel for row in rows),
        over_transforms=seconds / statistics.mean(transforms) if transforms else None,
        peak_mb=max(peaks, default=None),
        capped=any(row.capped for row in rows),
    )


def _decibels(mean_square_error: float) -> float:
    return decibels(max(mean_square_error, EXACT))


_HEADING: list[str] = [
    "method", "dB", "below", "excess", "worst", "(field)", "unrounded", "worst", "s",
    "x FFT", "ops/px", "MB",
]  # fmt: skip


def standing_tables(rows: Sequence[BenchRow]) -> Iterator[tuple[str, list[list[str]]]]:
    """Return a title and lines of text, a heading first, for each display; quicker ones first."""
    for display in dict.fromkeys(row.display for row in rows):
        own = [row for row in rows if row.display == display]
        kinds = " or ".join(sorted({row.yardstick.kind for row in own}))
        best = {row.field: _decibels(row.yardstick.mean_square_error) for row in own}
        title = f"{display}: {kinds} {statistics.mean(best.values()):.2f} dB, mean of {len(best)}"
        found = sorted(standings(own), key=lambda each: each.seconds)
        yield title, [_HEADING, *map(_line, found)]


def _line(found: Standing) -> list[str]:
    return [
        found.label,
        f"{found.psnr:.2f}",
        f"{found.below:.2f}",
        f"{found.excess_median:.1%}",
        f"{found.excess_worst:.1%}",
        found.worst_field,
        f"{found.unrounded_median:.1%}",
        f"{found.unrounded_worst:.1%}",
        f"{found.seconds:.3g}" + (" (cap)" if found.capped else ""),
        "" if found.over_transforms is None else f"{found.over_transforms:.1f}",
        f"{found.operations_per_pixel:,.0f}",
        "" if found.peak_mb is None else f"{found.peak_mb:.0f}",
    ]


def cap_lines(rows: Sequence[BenchRow], cap: float) -> Iterator[str]:
    """Say which methods the cap stopped, and where."""
    stopped: dict[tuple[str, str], list[BenchRow]] = {}
    for row in rows:
        if row.capped:
            stopped.setdefault((row.display, row.method), []).append(row)
    for (display, method), found in stopped.items():
        longest = max(row.seconds.median for row in found)
        fields = ", ".join(row.field for row in found)
        yield (
            f"{method} on {display} took up to {longest:.3g} s, over the cap of {cap:g} s, on "
            f"{fields}; there it was not run with more iterations"
        )
