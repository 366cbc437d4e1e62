"""A benchmark with all that it leaves behind; every file is whole at any time.

OUT/bench.json          rows as they come, and what they come to
OUT/frontier-*, excess-*   a chart for every display, PNG and SVG
OUT/scaling.json, scaling.png, scaling.svg   the same of a scaling run
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from layerfield.bench.figures import frontier_charts
from layerfield.bench.frontier import Contest, run_contest, subjects_of, unserved
from layerfield.bench.growth_figure import growth_chart
from layerfield.bench.reaching import reached
from layerfield.bench.records import FRONTIER, SCALING, known_rows, write_record
from layerfield.bench.rows import BenchRow, Effort
from layerfield.bench.scaling import Growth, ScaleRow, run_growth
from layerfield.bench.standing import standings
from layerfield.light_field import LightField
from layerfield.provenance import provenance

_MEASURES = {
    "seconds": "8-bit views in memory to 8-bit layers in memory, after a warm-up; what a method "
    "keeps of a display's constants from run to run counts once, in the warm-up",
    "operations": "additions, multiplications and function values; a multiply-add is two",
    "excess": "mean square error of light over that of the reference, minus 1, of 8-bit panels "
    "whose pixels are rounded each by itself",
    "unrounded": "mean square error before rounding",
}
Tick = Callable[[str], None]


def bench_methods(
    out: Path,
    fields: Sequence[LightField],
    contest: Contest,
    *,
    command: str,
    tick: Tick = lambda _: None,
) -> list[BenchRow]:
    """Measure methods on light fields; go on where the folder stands.

    Args:
        out: folder, made by `open_folder`.
        fields: light fields, with the views of the displays.
        contest: methods and displays.
        command: to be recorded, without paths.
        tick: called with a word on what is being done.

    Raises:
        ValueError: views that are not those of a display, rows of a run that was made otherwise, or
            of other things of the same names.
    """
    facts = _facts(contest.effort, contest.device) | {"measures": _MEASURES}
    earlier = known_rows(out / FRONTIER, facts)
    subjects = earlier.together_with(subjects_of(fields, contest), out / FRONTIER)
    known = [BenchRow.of_record(each) for each in earlier.rows]
    left_out = [
        why
        for name, _ in contest.methods
        for each in contest.displays
        if (why := unserved(name, each))
    ]

    def keep(rows: Sequence[BenchRow]) -> None:
        summary = [each.as_record() for each in standings(rows)]
        near = [each.as_record() for each in reached(rows)]
        record = facts | {"command": command, "subjects": subjects, "left_out": left_out}
        record |= {"summary": summary, "within_a_tenth_db": near}
        write_record(out / FRONTIER, record | {"rows": [row.as_record() for row in rows]})

    rows = run_contest(fields, contest, known=known, keep=keep, tick=tick)
    keep(rows)
    tick("drawing")
    for display in dict.fromkeys(row.display for row in rows):
        own = [row for row in rows if row.display == display]
        for chart in frontier_charts(own, made_on(contest.device), contest.effort.cap):
            chart.write(out)
    return rows


def bench_growth(
    out: Path, growth: Growth, *, command: str, tick: Tick = lambda _: None
) -> list[ScaleRow]:
    """Measure how time grows; go on where the folder stands.

    Args:
        out: folder, made by `open_folder`.
        growth: methods and sizes.
        command: to be recorded, without paths.
        tick: called with a word on what is being done.

    Raises:
        ValueError: rows of a run that was made otherwise.
    """
    facts = _facts(growth.effort, growth.device) | {"measures": {"seconds": _MEASURES["seconds"]}}
    known = [ScaleRow.of_record(each) for each in known_rows(out / SCALING, facts).rows]

    def keep(rows: Sequence[ScaleRow]) -> None:
        record = facts | {"command": command, "rows": [row.as_record() for row in rows]}
        write_record(out / SCALING, record)

    rows = run_growth(growth, known=known, keep=keep, tick=tick)
    keep(rows)
    tick("drawing")
    if any(row.seconds for row in rows):
        growth_chart(rows, made_on(growth.device)).write(out)
    return rows


def made_on(device: torch.device) -> str:
    """Return what times are taken on: processor and threads."""
    facts = provenance(device)
    threads = "" if device.type == "cuda" else f", {facts['threads']} threads"
    return f"{facts['processor']}{threads}".replace(", 1 threads", ", 1 thread")


def _facts(effort: Effort, device: torch.device) -> dict[str, Any]:
    return {"made_with": provenance(device), "effort": asdict(effort)}
