"""Quality against time on the five light fields, when each method arrives, and how time grows.

    python benchmarks/frontier.py OUT [--resume | --force]
    python benchmarks/frontier.py OUT --arrival [--resume | --force]
    python benchmarks/frontier.py OUT --scaling [--resume | --force]

The same as `layerfield bench`, which reads all light fields alike; these five want options of their
own. OUT is a folder with bench.json (or scaling.json) and figures. With --arrival methods for light
that adds up are asked, on two light fields, until they come within 0.1 dB of the optimum. Left out
are methods that are others in disguise (tiles, tones) and networks of other displays.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import torch
from five_fields import five_fields

from layerfield import Display, LightField
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
ARRIVING = {
    "fast": (1, 2, 3, 4),
    "fourier-admm": (5, 10, 15, 20, 25, 30, 40),
    "sweeps": (10, 20, 30, 40, 50),
    "gradient": (20, 40, 50, 60, 80, 100, 120),
    "nmf": (20, 100, 200, 400),
    "sart": (10, 40),
    "stacked-cnn": (0,),
}
CPU = torch.device("cpu")
EFFORT = Effort(repeats=3, cap=6.0)
PATIENT = Effort(repeats=5, cap=20.0)  # the first run of a size fills memory, and takes longer


@dataclass(frozen=True)
class Folder:
    """Where results go; made when there is something to measure."""

    out: Path
    resume: bool
    force: bool

    def opened(self) -> Path:
        open_folder(self.out, resume=self.resume, force=self.force)
        return self.out


def frontier(folder: Folder) -> None:
    contest = Contest([Display.load(name) for name in PRESETS], [*CONTENDERS.items()], EFFORT, CPU)
    compare(folder, [*five_fields().values()], contest, "python benchmarks/frontier.py OUT")


def arrival(folder: Folder) -> None:
    fields = [*five_fields("toys_9x9", "mit_dragons").values()]
    contest = Contest([Display.load("additive-3")], [*ARRIVING.items()], EFFORT, CPU)
    compare(folder, fields, contest, "python benchmarks/frontier.py OUT --arrival")


def compare(folder: Folder, fields: list[LightField], contest: Contest, command: str) -> None:
    rows = bench_methods(folder.opened(), fields, contest, command=command, tick=say)
    for title, table in [*standing_tables(rows), *reached_tables(rows)]:
        print(title)
        show(table)
    print(*cap_lines(rows, EFFORT.cap), sep="\n")


def scaling(folder: Folder) -> None:
    methods = [("fourier-admm", 10), ("fast", 4)]
    growth = Growth(("additive", "multiplicative"), methods, PATIENT, CPU)
    command = "python benchmarks/frontier.py OUT --scaling"
    show(growth_lines(bench_growth(folder.opened(), growth, command=command, tick=say)))


def say(line: str) -> None:
    print(line, flush=True)


def show(table: list[list[str]]) -> None:
    for line in table:
        print("  ".join(f"{cell:>12}" for cell in line))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--arrival", dest="run", action="store_const", const=arrival)
    which.add_argument("--scaling", dest="run", action="store_const", const=scaling)
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--resume", action="store_true", help="go on where an earlier run ended")
    how.add_argument("--force", action="store_true", help="replace an earlier run")
    given = parser.parse_args()
    try:
        (given.run or frontier)(Folder(given.out, given.resume, given.force))
    except ValueError as error:
        parser.error(str(error))
