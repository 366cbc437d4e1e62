"""Quality against time on the five light fields, and how time grows.

    python benchmarks/frontier.py OUT [--resume]
    python benchmarks/frontier.py OUT --scaling [--resume]

The same as `layerfield bench`, which reads all light fields alike; these five want options of their
own. OUT is a folder with bench.json (or scaling.json) and figures. Left out are methods that are
others in disguise (tiles, tones) and networks of other displays.
"""

import argparse
from pathlib import Path

import torch
from five_fields import five_fields

from layerfield import Display
from layerfield.bench.benchmark import bench_growth, bench_methods
from layerfield.bench.frontier import Contest
from layerfield.bench.reaching import reached_tables
from layerfield.bench.records import open_folder
from layerfield.bench.rows import Effort
from layerfield.bench.scaling import Growth, growth_lines
from layerfield.bench.standing import cap_lines, standing_tables

PRESETS = ("additive-3", "multiplicative-3")
CONTENDERS = {
    "fast": (1, 2, 3, 4, 5, 6, 8, 10, 12),
    "fourier-admm": (1, 2, 3, 5, 7, 10, 20),
    "sweeps": (1, 2, 5, 10, 15, 20),
    "nmf": (5, 20, 100),
    "ntf": (2, 5),
    "sart": (2, 10),
    "gradient": (5, 20, 50, 80, 100),
    "unet": (0,),
    "stacked-cnn": (0,),
}
CPU = torch.device("cpu")
EFFORT = Effort(repeats=3, cap=6.0)
PATIENT = Effort(repeats=5, cap=20.0)  # the first run of a size fills memory, and takes longer


def frontier(out: Path) -> None:
    models = [Display.load(name) for name in PRESETS]
    contest = Contest(models, list(CONTENDERS.items()), EFFORT, CPU)
    fields = list(five_fields().values())
    command = "python benchmarks/frontier.py OUT"
    rows = bench_methods(out, fields, contest, command=command, tick=say)
    for title, table in [*standing_tables(rows), *reached_tables(rows)]:
        print(title)
        show(table)
    print(*cap_lines(rows, EFFORT.cap), sep="\n")


def scaling(out: Path) -> None:
    methods = [("fourier-admm", 10), ("fast", 4)]
    growth = Growth(("additive", "multiplicative"), methods, PATIENT, CPU)
    command = "python benchmarks/frontier.py OUT --scaling"
    show(growth_lines(bench_growth(out, growth, command=command, tick=say)))


def say(line: str) -> None:
    print(line, flush=True)


def show(table: list[list[str]]) -> None:
    for line in table:
        print("  ".join(f"{cell:>12}" for cell in line))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--scaling", action="store_true")
    parser.add_argument("--resume", action="store_true")
    given = parser.parse_args()
    open_folder(given.out, resume=given.resume, force=False)
    (scaling if given.scaling else frontier)(given.out)
