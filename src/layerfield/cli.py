"""The command line: options in, one call each, tables out. One line and status 2 for errors."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from layerfield.between import parse_targets
from layerfield.cli_design import design_command
from layerfield.cli_fields import read_around, read_field
from layerfield.cli_options import (
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
from layerfield.cli_reproduction import reproduce_command
from layerfield.cli_training import train_command
from layerfield.demo import run_demo
from layerfield.disparity import estimate_disparity
from layerfield.display import Display, preset_names
from layerfield.display_spec import format_spec
from layerfield.evaluate import evaluate, parse_methods, write_rows
from layerfield.eyes import Eye, look, write_eyes
from layerfield.io import (
    FieldOptions,
    field_name,
    is_contact_sheet,
    load_light_field,
    refuse_existing,
    whole_directory,
    whole_file,
    write_contact_sheet,
)
from layerfield.methods import CHAIN_ITERATIONS
from layerfield.observers import parse_observers
from layerfield.panel_images import panel_projection
from layerfield.panels import largest_code
from layerfield.process import run
from layerfield.reference import cached_reference, reference
from layerfield.refusals import (
    keep_inputs,
    own_file,
    refuse_device,
    refuse_repeats,
    refuse_unknown,
    told_apart,
)
from layerfield.remarks import made_for_another_transfer, values_taken_for_light
from layerfield.result import (
    display_of,
    make_result,
    margin_of,
    mount,
    read_layers,
    read_panels,
    simulate_panels,
    view_size_of,
    write_result,
    write_views,
    write_views_array,
)
from layerfield.solvers.rounding import ROUNDINGS
from layerfield.synthesizer import METHODS, find_method, pose, synthesize
from layerfield.terminal import print_lines, print_tables, report, say, status
from layerfield.version import __version__
from layerfield.weights import shipped

app = typer.Typer(
    name="layerfield",
    help="Layer images for layered light field displays.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
_METHOD = "a name that `methods` lists, FILE.safetensors, or NETWORK+SOLVER"
_EYE = "X,Y[,Z] in mm, or X,Y in view steps: what an eye there sees; repeatable"
_OBSERVERS = "central:STEPS, or a CSV file of weights, a line for each row of views"
_METHODS = "such names, as a,b:100 (iterations),c+b:3"


@app.callback(invoke_without_command=True)
def _root(version: Annotated[bool, typer.Option("--version", help="print it")] = False) -> None:
    if version:
        say(f"layerfield {__version__}")
        raise typer.Exit


@app.command()
def demo(out: Out = Path("demo"), force: Force = False) -> None:
    """Make a sample light field, its layers on two displays, and compare methods."""
    with status() as tick:
        rows = run_demo(out, force=force, tick=tick)
    print_tables(rows)
    say(f"layers, views and comparison.png are in {out}")


@app.command()
@with_field_options
def info(
    field: Field,
    options: FieldOptions,
    contact: Annotated[
        Path | None, typer.Option("--contact-sheet", help="where to write it; FIELD-views.png")
    ] = None,
    force: Force = False,
) -> None:
    """Say what a light field holds, and draw a contact sheet of its views."""
    path = contact or Path(f"{field_name(field)}-views.png")
    keep_inputs(path, field)
    with whole_file(path, force=force or is_contact_sheet(path)) as temporary, status() as tick:
        tick("reading")
        loaded = load_light_field(field, options)
        tick("estimating disparity")
        report = estimate_disparity(loaded, order=options.order)
        write_contact_sheet(temporary, loaded)
    height, width = loaded.size
    low, high = loaded.views.min().item(), loaded.views.max().item()
    kind = "grey" if loaded.views.shape[-3] == 1 else "colour"
    say(f"views      {loaded.grid[0]}x{loaded.grid[1]}, {width}x{height} px, {kind}")
    say(f"values     {low:.3f} to {high:.3f}, mean {loaded.views.mean().item():.3f}")
    for line in [*report.lines(), *loaded.notes]:
        say(line)
    say(f"contact sheet: {path}")


@app.command()
@with_field_options
def synth(
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
    _refuse_targets(targets_between, [target])
    with status(total=count or None) as tick:
        tick("reading")
        loaded = read_field(field, options, targets_between)
        if target.panels:
            panel_projection(target, loaded.size)
        loaded = replace(loaded, views=loaded.views.to(device))
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
        write_result(out, result, simulate=simulate_views, force=force)
    for remark in values_taken_for_light(loaded, target):
        say(remark)
    report(out, loaded, result.facts)


@app.command(name="simulate")
def simulate_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="a result, or layer images")],
    out: Out,
    display: Annotated[
        str | None, typer.Option("--display", help="a preset or a TOML file; the result's own")
    ] = None,
    margin: Annotated[
        int | None, typer.Option("--margin", help="pixels by which layers exceed the views")
    ] = None,
    eye: Annotated[list[str] | None, typer.Option("--eye", help=_EYE)] = None,
    bits: Bits = 8,
    array: Annotated[
        bool, typer.Option("--array", help="write views.npy, unclipped float32, as well")
    ] = False,
    force: Force = False,
) -> None:
    """Write the views that viewers of these layers see; or what eyes anywhere see."""
    largest_code(bits)
    refuse_existing(out, force=force)
    keep_inputs(out, folder, own_file(display))
    layers, made_for = read_layers(folder), display_of(folder)
    shown_on = made_for if display is None else Display.load(display)
    if shown_on is None:
        raise ValueError(f"{folder} holds no display.toml; say which display with --display")
    eyes = [Eye.parse(text, shown_on) for text in eye or ()]
    panels = read_panels(folder) if shown_on.panels and margin is None and not eyes else []
    if panels:
        views = simulate_panels(panels, shown_on, view_size_of(folder))
    else:
        given = margin_of(folder) if margin is None else (margin, margin)
        mounted = mount(layers, shown_on, shown_on.margin if given is None else given)
        light = look(mounted, shown_on, eyes) if eyes else shown_on(mounted)
        views = shown_on.transfer.encode(light)
    with whole_directory(out, force=force) as temporary:
        if eyes:
            write_eyes(temporary / "views", views, bits)
        else:
            write_views(temporary / "views", views, shown_on, bits)
        if array:
            grid = (1, len(eyes)) if eyes else shown_on.geometry.grid or (1, len(views))
            write_views_array(temporary / "views.npy", views, grid)
        (temporary / "display.toml").write_text(format_spec(shown_on.spec), "utf-8")
    for remark in made_for_another_transfer(made_for, shown_on):
        say(remark)
    count = "1 view is" if len(views) == 1 else f"{len(views)} views are"
    say(f"{count} in {out / 'views'}")


@app.command(name="evaluate")
@with_field_options
def evaluate_command(
    paths: Annotated[list[str], typer.Argument(metavar="FIELD...", help="light fields")],
    names: Annotated[list[str], typer.Option("--display", help="preset or file; repeatable")],
    wanted: Annotated[str, typer.Option("--methods", help=_METHODS)],
    options: FieldOptions,
    iterations: Iterations = None,
    bits: Bits = 16,
    json: Annotated[Path | None, typer.Option("--json", help="file for the rows")] = None,
    between: Annotated[
        bool, typer.Option("--between", help="judge eyes between the viewpoints, too (--step 2)")
    ] = False,
    eye_map_file: Annotated[
        Path | None, typer.Option("--eye-map", help="PNG: PSNR against the position of the eye")
    ] = None,
    targets_between: TargetsBetween = None,
    force: Force = False,
) -> None:
    """Compare methods on light fields and displays, the reference beside them."""
    chosen = parse_methods(wanted, iterations)
    largest_code(bits)
    models = [Display.load(name) for name in names]
    refuse_repeats("displays", [model.name for model in models])
    found = [find_method(name) for name, _ in chosen]
    for out in filter(None, (json, eye_map_file)):
        keep_inputs(out, *paths, *map(own_file, names), *(method.file for method in found))
    if between or eye_map_file is not None:
        _refuse_lists(models, "--between and --eye-map")
    _refuse_targets(targets_between, models)
    for model in models:
        for method in found:
            method.refuse_unserved(model)
    loaded = told_apart([read_field(field, options, targets_between) for field in paths], paths)
    for field in loaded:
        for model in models:
            pose(field, model)
    around = [
        read_around(path, options, field, between=between)
        for path, field in zip(paths, loaded, strict=True)
        if between or eye_map_file is not None
    ]
    with _file_or_nothing(json, force) as path, _file_or_nothing(eye_map_file, force) as picture:
        with status(total=len(loaded) * len(models) * (len(chosen) + 1)) as tick:
            rows = evaluate(
                loaded, models, chosen, bits=bits, isolate=True, around=around, tick=tick
            )
        if path is not None:
            write_rows(path, rows)
        if picture is not None:
            from layerfield.report.eye_map import write_eye_map  # noqa: PLC0415  slow to import

            write_eye_map(picture, rows)
    for remark in [note for f in loaded for d in models for note in values_taken_for_light(f, d)]:
        say(remark)
    print_tables(rows)


@app.command()
def displays() -> None:
    """List the displays that come with the package."""
    found = [Display.load(name) for name in preset_names()]
    lines = [["name", "link", "views", "layers", "description"]]
    for display in found:
        views = "x".join(map(str, display.geometry.grid or (display.view_count,)))
        lines.append([display.name, display.link.name, views, str(display.layer_count)])
        lines[-1].append(display.spec.description)
    print_lines(lines)


@app.command()
def methods() -> None:
    """List the methods that make layers."""
    lines = [["name", "iterations", "displays", "summary"]]
    for method in METHODS.values():
        links = ", ".join(method.links)
        lines.append([method.name, str(method.iterations), links, method.summary])
    print_lines(lines)
    say("A name that `layerfield weights` lists, or FILE.safetensors, is the network with those")
    say("weights. NETWORK+SOLVER, as unet+fourier-admm, is a network followed by")
    say(f"{CHAIN_ITERATIONS} iterations of a solver.")


app.command(name="design")(design_command)
app.command(name="train")(train_command)
app.command(name="reproduce")(reproduce_command)


@app.command(name="weights")
def weights_command() -> None:
    """List the trained networks that come with the package, with their scores."""
    entries = shipped()
    if not entries:
        say("no weights are shipped; train a network with layerfield train RECIPE.toml")
        return
    lines = [["name", "network", "display", "MB", "scores", "recipe"]]
    for entry in entries:
        display, size = entry.trained_for.name, f"{entry.megabytes:g}"
        lines.append([entry.name, entry.network, display, size, entry.scores, entry.recipe])
    print_lines(lines)


def main() -> None:
    """Run the command line."""
    run(app)


def _refuse_targets(targets: str | None, displays: list[Display]) -> None:
    if targets is not None:
        parse_targets(targets)
        _refuse_lists(displays, "--targets-between")


def _refuse_lists(displays: list[Display], option: str) -> None:
    for display in displays:
        if display.geometry.grid is None:
            raise ValueError(
                f"the viewpoints of display '{display.name}' are a list; {option} needs a grid of "
                "them ('views')"
            )


@contextmanager
def _file_or_nothing(path: Path | None, force: bool) -> Iterator[Path | None]:
    if path is None:
        yield None
        return
    with whole_file(path, force=force) as temporary:
        yield temporary
