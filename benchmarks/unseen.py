"""Learned steps against the direct solver and sweeps, on displays they were not trained on.

    python benchmarks/unseen.py OUT.json

Seven by seven views between disparities of 1.5 and -1.5, three by three views on two layers, and a
physical display seen in perspective, in linear light; light that adds up and light that multiplies.
Beside each run of `fast`: by how much it is better than the best of the others in the same time,
and what share of their time it takes to be as good.
"""

import argparse
import json
import math
import os
from pathlib import Path

import numpy as np
import torch
from outputs import output_file

from layerfield import Display, FieldOptions, load_light_field
from layerfield.bench.road import EightBitViews
from layerfield.bench.rows import BenchRow, Effort, measured
from layerfield.display_spec import parse_spec
from layerfield.io import whole_file
from layerfield.provenance import provenance

LINKS = ("additive", "multiplicative")
FAST = "fast"
CONTENDERS = {FAST: range(1, 7), "fourier-admm": (1, 2, 3, 5, 7, 10), "sweeps": (1, 2, 5)}
EFFORT = Effort(repeats=7)
UNSEEN = {
    "7x7 views, four layers": (
        "toys_9x9",
        {"views": "7x7"},
        "views = [7, 7]\ndisparity = [1.5, 0.5, -0.5, -1.5]",
    ),
    "3x3 views, two layers": (
        "toys_9x9",
        {"views": "3x3"},
        "views = [3, 3]\ndisparity = [1, -1]",
    ),
    "in perspective, linear light": (
        "stanford_cards",
        {"views": "5x5", "scale": 0.5},
        "views = [5, 5]\ndepth_mm = [12, 0, -12]\npitch_um = 400\nviewing_distance_mm = 500\n"
        'viewing_angle_deg = 8\ntransfer = "srgb"',
    ),
}


def rows_on(field: Path, options: dict, display: Display) -> list[BenchRow]:
    """Measure everything on one display."""
    views = EightBitViews.of(load_light_field(field, FieldOptions.parse(**options)))
    made = []
    for method, budgets in CONTENDERS.items():
        for count in budgets:
            made.append(measured(views, display, method, count, EFFORT))
            print(display.name, display.link.name, line(made[-1]), flush=True)
    return made


def line(row: BenchRow) -> str:
    return f"{row.label}: {1e3 * row.seconds.median:.1f} ms, {row.psnr:.2f} dB"


def compared(rows: list[BenchRow]) -> list[dict]:
    """Return what was measured, and how runs of `fast` stand to the others.

    Those are taken as one curve: the best of them in no more time, with straight lines between in
    decibels over the logarithm of time. Faster than the fastest and better than the best of them
    there is none.
    """
    times, decibels = frontier([row for row in rows if row.method != FAST])
    found = []
    for row in rows:
        time, better, share = row.seconds.median, None, None
        if row.method == FAST and times[0] <= time:
            better = row.psnr - float(np.interp(np.log(time), np.log(times), decibels))
        if row.method == FAST and decibels[0] <= row.psnr <= decibels[-1]:
            share = time / math.exp(np.interp(row.psnr, decibels, np.log(times)))
        facts = {"method": row.method, "iterations": row.iterations, "psnr": row.psnr}
        facts |= {"seconds": time, "fastest": row.seconds.fastest}
        found.append(facts | {"better_by": better, "share_of_time": share})
    return found


def frontier(rows: list[BenchRow]) -> tuple[list[float], list[float]]:
    """Return seconds and PSNR of those that no other beats in no more time, slower and better."""
    times, decibels = list[float](), list[float]()
    for row in sorted(rows, key=lambda row: row.seconds.median):
        if not decibels or row.psnr > decibels[-1]:
            times.append(row.seconds.median)
            decibels.append(row.psnr)
    return times, decibels


def main(out: Path) -> None:
    default = Path(__file__).parents[2] / "shared" / "lightfields"
    folder = Path(os.environ.get("LAYERFIELD_FIELDS") or default)
    results = []
    for name, (field, options, text) in UNSEEN.items():
        for link in LINKS:
            spec = f'name = "{name}"\nlink = "{link}"\n{text}'
            display = Display(parse_spec(spec, name))
            runs = compared(rows_on(folder / field, options, display))
            better = [run["better_by"] for run in runs if run["better_by"] is not None]
            shares = [run["share_of_time"] for run in runs if run["share_of_time"] is not None]
            facts = {"field": field, "options": options, "display": spec}
            found = {"better_by": max(better), "share_of_time": min(shares, default=None)}
            results.append(facts | found | {"runs": runs})
            print(f"{name}, {link}: {found}", flush=True)
    facts = {"command": "python benchmarks/unseen.py OUT.json", "displays": results}
    with whole_file(out, force=True) as path:
        path.write_text(json.dumps(facts | provenance(torch.device("cpu")), indent=1))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=output_file)
    given = parser.parse_args()
    try:
        main(given.out)
    except ValueError as error:
        parser.error(str(error))
