"""The command `reproduce`."""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from layerfield.cli.options import Force, Out, with_field_options
from layerfield.cli.refusals import keep_inputs, refuse_small, refuse_unknown, told_apart
from layerfield.cli.terminal import say, status
from layerfield.io import FieldOptions, load_light_field, refuse_existing
from layerfield.light_field import LightField

REPEATS, MEMORY = 3, True  # how carefully time and memory are measured
_PAPERS = ("gao2024",)
_SMALLEST = 32  # pixels of a view: figures of smaller ones show nothing


@with_field_options
def reproduce_command(
    paper: Annotated[str, typer.Argument(metavar="PAPER", help="gao2024")],
    out: Out,
    options: FieldOptions,
    field: Annotated[
        list[str] | None,
        typer.Option("--field", metavar="FIELD", help="target light field; repeatable"),
    ] = None,
    runs: Annotated[
        Path | None, typer.Option("--runs", help="folder of trainings; those that ship")
    ] = None,
    train: Annotated[
        bool, typer.Option("--train", help="train both networks first, into --runs; resumes")
    ] = False,
    ablations: Annotated[
        bool, typer.Option("--ablations", help="train small variants, too; 10 to 20 minutes")
    ] = False,
    iterations: Annotated[
        int, typer.Option("--iterations", min=1, help="to follow the iterative solvers for")
    ] = 500,
    force: Force = False,
) -> None:
    """Rebuild a paper's figures and say which of its claims hold."""
    refuse_unknown("paper", paper, _PAPERS)
    from layerfield.reproduction.ablations import ablate  # noqa: PLC0415, they take a second
    from layerfield.reproduction.gao2024 import Reproduction, reproduce  # noqa: PLC0415
    from layerfield.reproduction.measures import Effort  # noqa: PLC0415
    from layerfield.reproduction.runs import SHIPPED_RUNS, train_both  # noqa: PLC0415
    from layerfield.reproduction.statement import claim_lines  # noqa: PLC0415

    if (train or ablations) and find_spec("lightning") is None:
        raise ValueError(
            "training needs lightning; install it with pip install 'layerfield[train]'"
        )
    refuse_existing(out, force=force)
    keep_inputs(out, runs, *(field or []))
    if runs is not None and not train and not runs.is_dir():
        raise ValueError(f"there is no folder {runs} of trainings; make it with --train")
    loaded = told_apart([_load(path, options) for path in field or []], field or [])
    with status() as tick:
        place = runs or (out.with_name(f"{out.name}-runs") if train else SHIPPED_RUNS)
        if train:
            train_both(place, tick)
        given = Reproduction(loaded, place, Effort(iterations, REPEATS, MEMORY))
        more = (lambda folder: ablate(folder, tick=tick)) if ablations else None
        claims = reproduce(out, given, more=more, force=force, tick=tick)
    for line in claim_lines(claims):
        say(line)
    say(f"report.html, its figures, claims.md and claims.json are in {out}")


def _load(path: str, options: FieldOptions) -> LightField:
    loaded = load_light_field(path, options)
    refuse_small(loaded, _SMALLEST)
    return loaded
