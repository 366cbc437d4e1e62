"""The command `bench`."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import torch
import typer

from layerfield.bench.frontier import BUDGETS, Contest, parse_budgets, parse_contenders, unserved
from layerfield.bench.reaching import reached_tables
from layerfield.bench.records import open_folder
from layerfield.bench.rows import Effort
from layerfield.bench.scaling import Growth, growth_lines
from layerfield.bench.standing import cap_lines, standing_tables
from layerfield.cli.fields import read_field
from layerfield.cli.options import Device, Force, Out, with_field_options
from layerfield.cli.refusals import (
    keep_inputs,
    own_file,
    refuse_device,
    refuse_repeats,
    told_apart,
)
from layerfield.cli.terminal import print_lines, say, status
from layerfield.display import Display
from layerfield.evaluate import parse_methods
from layerfield.io import FieldOptions
from layerfield.synthesizer import METHODS, find_method, pose

_DISPLAY, _GROWING = "additive-3", "fourier-admm"
_BUDGETS = ",".join(map(str, BUDGETS))


@with_field_options
def bench_command(
    out: Out,
    options: FieldOptions,
    paths: Annotated[
        list[str] | None, typer.Argument(metavar="[FIELD]...", help="light fields")
    ] = None,
    names: Annotated[
        list[str] | None, typer.Option("--display", help="preset or file; repeatable; additive-3")
    ] = None,
    wanted: Annotated[
        str | None, typer.Option("--methods", help="such names, as a,b:100 (iterations); all")
    ] = None,
    budgets: Annotated[
        str, typer.Option("--budgets", help="iterations of methods that are given none")
    ] = _BUDGETS,
    repeats: Annotated[
        int, typer.Option("--repeats", min=1, help="runs whose median counts, at least")
    ] = Effort.repeats,
    cap: Annotated[
        float, typer.Option("--cap", help="seconds of a run, behind which a method stops")
    ] = Effort.cap,
    memory: Annotated[
        bool, typer.Option("--memory", help="peak memory, too; a process for each method")
    ] = False,
    scaling: Annotated[
        bool, typer.Option("--scaling", help="how time grows with pixels, views and layers")
    ] = False,
    device: Device = "cpu",
    resume: Annotated[bool, typer.Option("--resume", help="go on with what is in --out")] = False,
    force: Force = False,
) -> None:
    """Measure what methods reach in what time, and how that time grows."""
    given, place, effort = paths or [], _place(device), Effort(repeats, cap, memory)
    if not given and not scaling:
        raise ValueError("there is nothing to measure; give light fields, or --scaling")
    models = [Display.load(name) for name in names or [_DISPLAY]]
    refuse_repeats("displays", [model.name for model in models])
    chosen = wanted or ",".join(name for name in METHODS if _serves(name, models))
    contest = Contest(models, parse_contenders(chosen, parse_budgets(budgets)), effort, place)
    files = [find_method(name).file for name, _ in contest.methods]
    keep_inputs(out, *given, *map(own_file, names or []), *files)
    fields = told_apart([read_field(path, options) for path in given], given)
    for field in fields:
        for model in models:
            pose(field, model)
    links = list(dict.fromkeys(model.link.name for model in models))
    growth = Growth(links, parse_methods(wanted or _GROWING), effort, place)
    texts = {
        "methods": wanted and _without_folders(wanted),
        "budgets": None if budgets == _BUDGETS else budgets,
        "repeats": None if repeats == Effort.repeats else f"{repeats}",
        "cap": None if cap == Effort.cap else f"{cap:g}",
        "device": None if device == "cpu" else device,
    }
    flags = [name for name, on in (("--memory", memory), ("--scaling", scaling)) if on]
    command = _command([*given], [*(names or [])], texts | options.written(), flags)
    open_folder(out, resume=resume, force=force)
    from layerfield.bench.benchmark import bench_growth, bench_methods  # noqa: PLC0415  slow

    with status() as tick:
        rows = bench_methods(out, fields, contest, command=command, tick=tick) if fields else []
        grown = bench_growth(out, growth, command=command, tick=tick) if scaling else []
    for title, table in [*standing_tables(rows), *reached_tables(rows)]:
        say(title)
        print_lines(table)
    for line in cap_lines(rows, cap):
        say(line)
    if grown:
        print_lines(growth_lines(grown))
    say(f"figures and all numbers are in {out}")


def _place(device: str) -> torch.device:
    refuse_device(device)
    return torch.device(device)


def _serves(method: str, displays: Sequence[Display]) -> bool:
    return any(unserved(method, display) is None for display in displays)


def _command(
    paths: Sequence[str],
    displays: Sequence[str],
    texts: Mapping[str, str | None],
    flags: Sequence[str],
) -> str:
    """The command as it is recorded: names of files, no folders."""
    named = [("display", Path(name).name) for name in displays]
    named += [(name, text) for name, text in texts.items() if text]
    words = [word for name, text in named for word in (f"--{name}", text)]
    return shlex.join(["layerfield", "bench", *(Path(path).name for path in paths), *words, *flags])


def _without_folders(methods: str) -> str:
    """Weight files are recorded by their name alone."""
    return ",".join(Path(entry).name for entry in methods.split(","))
