"""Time to quality: the first number of iterations that comes near enough to the reference."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from layerfield.bench.rows import BenchRow

TENTH_DB = 10**0.01 - 1  # excess error that is 0.1 dB, 2.3 %


@dataclass(frozen=True)
class Reached:
    """When a method comes near enough on one light field and display.

    Args:
        field: name.
        display: name.
        method: title.
        excess: the most that counts as near enough.
        iterations: the first measured number with 8-bit panels near enough; None if none was.
        seconds: of that run.
        unrounded_iterations: the same for layers before rounding.
        unrounded_seconds: of that run.
        tried: seconds of the longest run.
        capped: the cap stopped the method.
    """

    field: str
    display: str
    method: str
    excess: float
    iterations: int | None
    seconds: float | None
    unrounded_iterations: int | None
    unrounded_seconds: float | None
    tried: float
    capped: bool

    def as_record(self) -> dict[str, Any]:
        """Return it as plain data for JSON."""
        return asdict(self)


def reached(rows: Sequence[BenchRow], most: float = TENTH_DB) -> list[Reached]:
    """Return when every method comes within an excess error, on every field and display."""
    groups: dict[tuple[str, str, str], list[BenchRow]] = {}
    for row in sorted(rows, key=lambda row: row.iterations):
        groups.setdefault((row.field, row.display, row.method), []).append(row)
    return [_reached(groups[key], most) for key in dict.fromkeys(row.key[:3] for row in rows)]


def _reached(rows: Sequence[BenchRow], most: float) -> Reached:
    first = next((row for row in rows if row.excess <= most), None)
    unrounded = next((row for row in rows if row.excess_unrounded <= most), None)
    return Reached(
        *rows[0].key[:3],
        excess=most,
        iterations=first and first.iterations,
        seconds=first and first.seconds.median,
        unrounded_iterations=unrounded and unrounded.iterations,
        unrounded_seconds=unrounded and unrounded.seconds.median,
        tried=max(row.seconds.median for row in rows),
        capped=any(row.capped for row in rows),
    )


def reached_tables(rows: Sequence[BenchRow]) -> Iterator[tuple[str, list[list[str]]]]:
    """Return a title and lines of text, a heading first, for each display."""
    found = reached(rows)
    for display in dict.fromkeys(each.display for each in found):
        own = [each for each in found if each.display == display]
        fields = list(dict.fromkeys(each.field for each in own))
        cells = {(each.method, each.field): _cell(each) for each in own}
        yield (
            f"{display}: seconds (iterations) to come within 0.1 dB of the reference",
            [["method", *fields]]
            + [
                [method, *(cells.get((method, field), "") for field in fields)]
                for method in dict.fromkeys(each.method for each in own)
            ],
        )


def _cell(found: Reached) -> str:
    if found.seconds is not None:
        return f"{found.seconds:.3g} ({found.iterations})"
    if found.unrounded_seconds is not None:
        return f"unrounded {found.unrounded_seconds:.3g} ({found.unrounded_iterations})"
    return f"not in {found.tried:.3g}" + (" (cap)" if found.capped else "")
