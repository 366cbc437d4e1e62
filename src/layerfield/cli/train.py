"""The command `train`."""

import shlex
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from layerfield.cli.options import Device, Force, with_field_options
from layerfield.cli.refusals import refuse_device
from layerfield.cli.terminal import say, status
from layerfield.io import FieldOptions, load_light_field
from layerfield.networks import Network
from layerfield.shipped import find_shipped, load_shipped
from layerfield.training.adapt import adaptation
from layerfield.training.loop import Run, train
from layerfield.training.recipe import read_recipe
from layerfield.training.records import WEIGHTS, refuse_run
from layerfield.training.start import network_for, refuse_other_network
from layerfield.training.steps import StepsRun, train_steps
from layerfield.training.steps_recipe import StepsRecipe, is_of_steps, read_steps_recipe
from layerfield.weights import read_weights


@with_field_options
def train_command(
    recipe: Annotated[str, typer.Argument(metavar="RECIPE", help="a TOML file, or one that ships")],
    options: FieldOptions,
    out: Annotated[Path | None, typer.Option("--out", help="folder; runs/RECIPE")] = None,
    device: Device = "cpu",
    devices: Annotated[int, typer.Option("--devices", min=1, help="that train together")] = 1,
    resume: Annotated[bool, typer.Option("--resume", help="go on from the checkpoint")] = False,
    epochs: Annotated[int | None, typer.Option("--epochs", min=1, help="the recipe's own")] = None,
    adapt: Annotated[
        str | None, typer.Option("--adapt", metavar="FIELD", help="tune to one light field")
    ] = None,
    weights: Annotated[
        Path | None, typer.Option("--weights", help="to adapt; those that ship if not given")
    ] = None,
    force: Force = False,
) -> None:
    """Train a network or learned steps, or adapt a trained network to a light field."""
    if is_of_steps(recipe):
        _refuse_for_steps(
            adapt=adapt,
            weights=weights,
            epochs=epochs,
            device=None if device == "cpu" else device,
            devices=None if devices == 1 else devices,
        )
        _train_steps(read_steps_recipe(recipe), out, resume, force, _command(recipe, None, None))
        return
    if find_spec("lightning") is None:
        raise ValueError(
            "training needs lightning; install it with pip install 'layerfield[train]'"
        )
    refuse_device(device)
    chosen = read_recipe(recipe)
    run = Run(
        recipe=chosen if epochs is None else chosen.model_copy(update={"epochs": epochs}),
        out=Path("runs", chosen.name + ("-adapted" if adapt else "")) if out is None else out,
        folder=Path(recipe).parent,
        device=device,
        devices=devices,
        resume=resume,
        force=force,
        command=_command(recipe, epochs, adapt),
    )
    refuse_run(run.out, resume=resume, force=force)
    run.display  # noqa: B018  a display that is not there is an error before the work
    if adapt is not None:
        run = adaptation(run, load_light_field(adapt, options), _trained(run, weights))
    with status(total=run.recipe.epochs) as tick:
        facts = train(replace(run, tick=tick))
    best = facts["best"]
    say(
        f"{run.recipe.name}: {best['validation_psnr']:.2f} dB on validation scenes, "
        f"{best['test_psnr']:.2f} dB on test scenes after {facts['steps']} steps, "
        f"{facts['seconds']:.0f} s ({facts['reference']['method']}: "
        f"{facts['reference']['validation_psnr']:.2f} and {facts['reference']['test_psnr']:.2f} dB)"
    )
    for note in facts["notes"]:
        say(f"note: {note}")
    say(f"the best network is {run.out / WEIGHTS}; use it with --method {run.out / WEIGHTS}")


def _refuse_for_steps(**given: object) -> None:
    """Refuse what only networks know."""
    for name, value in given.items():
        if value is not None:
            raise ValueError(
                f"found --{name} {value}, but the recipe is of learned steps, which are trained "
                "whole and on the processor; leave it out"
            )


def _train_steps(
    recipe: StepsRecipe, out: Path | None, resume: bool, force: bool, command: str
) -> None:
    run = StepsRun(
        recipe=recipe,
        out=Path("runs", recipe.name) if out is None else out,
        resume=resume,
        force=force,
        command=command,
    )
    with status(total=100) as tick:
        facts = train_steps(replace(run, tick=tick))
    for method, figures in facts["figures"]["test"].items():
        listed = ", ".join(f"{value:.2f} ({steps})" for steps, value in figures.items())
        say(f"{method}, dB on test scenes (steps): {listed}")
    say(f"the learned steps are {run.out / WEIGHTS}")


def _trained(run: Run, weights: Path | None) -> Network:
    """The network to adapt."""
    if weights is None:
        found = load_shipped(find_shipped(run.recipe.network, run.display))
    else:
        found = read_weights(weights)
        found.refuse_other(run.display)
    refuse_other_network(network_for(run.recipe, run.display), found, run.recipe)
    return found.network


def _command(recipe: str, epochs: int | None, adapt: str | None) -> str:
    """The command as it is recorded: names of files, no folders."""
    parts = ["layerfield", "train", Path(recipe).name]
    parts += ["--epochs", str(epochs)] if epochs is not None else []
    parts += ["--adapt", Path(adapt).name] if adapt is not None else []
    return shlex.join(parts)
