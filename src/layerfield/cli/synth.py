"""The command `synth`."""

from dataclasses import replace
from typing import Annotated

import typer

from layerfield.cli.fields import read_field
from layerfield.cli.options import (
    Bits,
    Device,
    DisplayName,
    Field,
    Force,
    Iterations,
    Out,
    TargetsBetween,
    recorded,
    with_field_options,
)
from layerfield.cli.refusals import (
    keep_inputs,
    own_file,
    refuse_device,
    refuse_targets,
    refuse_unknown,
)
from layerfield.cli.terminal import report, say, status
from layerfield.display import Display
from layerfield.io import FieldOptions, refuse_existing
from layerfield.observers import parse_observers
from layerfield.panel_images import panel_projection
from layerfield.panels import largest_code
from layerfield.reference import cached_reference, reference
from layerfield.remarks import values_taken_for_light
from layerfield.result import make_result, write_result
from layerfield.solvers.rounding import ROUNDINGS
from layerfield.synthesizer import find_method, pose, synthesize

_METHOD = "a name that `methods` lists, FILE.safetensors, or NETWORK+SOLVER"
_OBSERVERS = "central:STEPS, or a CSV file of weights, a line for each row of views"


@with_field_options
def synth_command(
    field: Field,
    display: DisplayName,
    out: Out,
    options: FieldOptions,
    method: Annotated[str, typer.Option("--method", help=_METHOD)] = "fourier-admm",
    iterations: Iterations = None,
    bits: Bits = 8,
    rounding: Annotated[
        str, typer.Option("--rounding", help="of 8-bit layers: joint or nearest")
    ] = "joint",
    simulate_views: Annotated[
        bool, typer.Option("--simulate", help="write the views that the layers show, too")
    ] = False,
    write_targets: Annotated[
        bool, typer.Option("--targets", help="write the views that were aimed at, too")
    ] = False,
    compare: Annotated[
        bool, typer.Option("--reference", help="compute the optimum (or best known) to compare")
    ] = False,
    history: Annotated[
        bool, typer.Option("--history", help="record the error of every iteration")
    ] = False,
    targets_between: TargetsBetween = None,
    observers: Annotated[
        str | None, typer.Option("--observers", help="who looks from where: " + _OBSERVERS)
    ] = None,
    device: Device = "cpu",
    force: Force = False,
) -> None:
    """Make the layer images that show a light field on a display."""
    # What can be refused is refused before the work, not after it.
    target, chosen = Display.load(display), find_method(method)
    count = chosen.count(iterations)
    largest_code(bits)
    refuse_unknown("rounding", rounding, ROUNDINGS)
    refuse_device(device)
    refuse_existing(out, force=force)
    keep_inputs(out, field, own_file(display), chosen.file, own_file(observers))
    chosen.refuse_unserved(target)
    refuse_targets(targets_between, [target])
    with status(total=count or None) as tick:
        tick("reading")
        loaded = read_field(field, options, targets_between)
        if target.panels:
            panel_projection(target, loaded.size)
        loaded = replace(loaded, stored=loaded.stored.to(device))
        solution = synthesize(
            loaded,
            target,
            method=method,
            iterations=count,
            weights=None if observers is None else parse_observers(observers, loaded.grid),
            history=history,
            callback=lambda done, _: tick(chosen.title, done),
        )
        problem = pose(replace(loaded, between=None), target)
        known = reference(problem, tick=tick) if compare else cached_reference(problem)
        tick("rounding and writing")
        result = make_result(
            loaded,
            target,
            solution,
            method=chosen.title,
            bits=bits,
            rounding=rounding,
            reference=known,
            options=recorded(options, targets_between, observers),
        )
        targets = loaded if write_targets else None
        write_result(out, result, simulate=simulate_views, targets=targets, force=force)
    for remark in values_taken_for_light(loaded, target):
        say(remark)
    report(out, loaded, result.facts)
