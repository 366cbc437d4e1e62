"""The command line: options in, one call each, tables out. One line and status 2 for errors."""

import inspect
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, NoReturn

import torch
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from layerfield.demo import run_demo
from layerfield.disparity import estimate_disparity
from layerfield.display import Display, preset_names
from layerfield.display_spec import format_spec
from layerfield.evaluate import Row, evaluate, parse_methods, tables, write_rows
from layerfield.io import (
    FieldOptions,
    contact_sheet,
    load_light_field,
    refuse_existing,
    whole_directory,
    whole_file,
)
from layerfield.light_field import LightField
from layerfield.reference import cached_reference, reference
from layerfield.result import (
    display_of,
    make_result,
    margin_of,
    read_layers,
    simulate,
    write_result,
    write_views,
    write_views_array,
)
from layerfield.synthesizer import METHODS, find_method, pose, synthesize
from layerfield.version import __version__

app = typer.Typer(
    name="layerfield",
    help="Layer images for layered light field displays.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
_PIPE_WIDTH = 200  # tables in a pipe are not squeezed into 80 columns
_out = Console(highlight=False, width=None if sys.stdout.isatty() else _PIPE_WIDTH)
_err = Console(stderr=True, highlight=False)

Field = Annotated[str, typer.Argument(help="folder of views, picture, .npy, .npz or .h5")]
Out = Annotated[Path, typer.Option("--out", help="folder to make")]
Force = Annotated[bool, typer.Option("--force", help="replace an earlier result")]
Bits = Annotated[int, typer.Option("--bits", help="of the images that are written: 8 or 16")]
DisplayName = Annotated[str, typer.Option("--display", help="a preset or a TOML file")]
Device = Annotated[str, typer.Option("--device", help="cpu or cuda")]
Iterations = Annotated[
    int | None, typer.Option("--iterations", help="the method's own if not given")
]

_FIELD_OPTIONS = {
    "grid": "rows x columns of the stored views, as 5x5",
    "order": "corner of the first view and what runs first: tl-row, bl-row, tr-column ...",
    "step": "take every n-th view in both directions",
    "views": "take the central views, as 5x5",
    "shift": "subtract this from every disparity, pixels per view",
    "scale": "resize every view by this factor",
    "crop": "WxH (central) or WxH+X+Y, pixels",
    "quilt": "the picture is a quilt: CxR or CxRaA",
    "lenslet": "the picture is seen through lenslets of this many pixels",
}


def _with_field_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options that say how to read a light field, gathered as `options`."""

    @wraps(command)
    def wrapper(*args: Any, **values: Any) -> None:
        chosen = {name: values.pop(name) for name in _FIELD_OPTIONS}
        command(*args, options=FieldOptions.parse(**chosen), **values)

    own = [p for p in inspect.signature(command).parameters.values() if p.name != "options"]
    shared = [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[
                str | None, typer.Option(f"--{name}", help=text, rich_help_panel="Light field")
            ],
        )
        for name, text in _FIELD_OPTIONS.items()
    ]
    keyword = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in own]
    wrapper.__signature__ = inspect.Signature([*keyword, *shared])  # pyright: ignore[reportAttributeAccessIssue]
    wrapper.__annotations__ = {p.name: p.annotation for p in [*keyword, *shared]}
    return wrapper


@app.callback(invoke_without_command=True)
def _root(version: Annotated[bool, typer.Option("--version", help="print it")] = False) -> None:
    if version:
        _out.print(f"layerfield {__version__}")
        raise typer.Exit


@app.command()
def demo(out: Out = Path("demo"), force: Force = False) -> None:
    """Make a sample light field, its layers on two displays, and compare methods."""
    with _status() as tick:
        rows = run_demo(out, force=force, tick=tick)
    _print_tables(rows)
    _out.print(f"layers, views and comparison.png are in {out}", soft_wrap=True)


@app.command()
@_with_field_options
def info(
    field: Field,
    options: FieldOptions,
    contact: Annotated[
        Path | None, typer.Option("--contact-sheet", help="where to write it; FIELD-views.png")
    ] = None,
) -> None:
    """Say what a light field holds, and draw a contact sheet of its views."""
    with _status() as tick:
        tick("reading")
        loaded = load_light_field(field, options)
        tick("estimating disparity")
        report = estimate_disparity(loaded, order=options.order)
    height, width = loaded.size
    low, high = loaded.views.min().item(), loaded.views.max().item()
    kind = "grey" if loaded.views.shape[-3] == 1 else "colour"
    _out.print(f"views      {loaded.grid[0]}x{loaded.grid[1]}, {width}x{height} px, {kind}")
    _out.print(f"values     {low:.3f} to {high:.3f}, mean {loaded.views.mean().item():.3f}")
    for line in [*report.lines(), *loaded.notes]:
        _out.print(line, soft_wrap=True)
    path = contact or Path(f"{loaded.name}-views.png")
    with whole_file(path, force=True) as temporary:
        contact_sheet(loaded).save(temporary, format="PNG")
    _out.print(f"contact sheet: {path}", soft_wrap=True)


@app.command()
@_with_field_options
def synth(
    field: Field,
    display: DisplayName,
    out: Out,
    options: FieldOptions,
    method: Annotated[str, typer.Option("--method", help="see `methods`")] = "fourier-admm",
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
    device: Device = "cpu",
    force: Force = False,
) -> None:
    """Make the layer images that show a light field on a display."""
    target, count = Display.load(display), find_method(method).iterations
    count = count if iterations is None else iterations
    refuse_existing(out, force=force)
    with _status(total=count) as tick:
        tick("reading")
        loaded = _load(field, options, device)
        solution = synthesize(
            loaded,
            target,
            method=method,
            iterations=count,
            history=history,
            callback=lambda done, _: tick(method, done),
        )
        problem = pose(loaded, target)
        known = reference(problem, tick=tick) if compare else cached_reference(problem)
        tick("rounding and writing")
        result = make_result(
            loaded,
            target,
            solution,
            method=method,
            bits=bits,
            rounding=rounding,
            reference=known,
            options=_recorded(options),
        )
        write_result(out, result, simulate=simulate_views, force=force)
    _report(out, loaded, result.facts)


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
    bits: Bits = 8,
    array: Annotated[
        bool, typer.Option("--array", help="write views.npy, unclipped float32, as well")
    ] = False,
    force: Force = False,
) -> None:
    """Write the views that viewers of these layers see."""
    refuse_existing(out, force=force)
    layers, shown_on = read_layers(folder), display_of(folder)
    if display is not None:
        shown_on = Display.load(display)
    if shown_on is None:
        raise ValueError(f"{folder} holds no display.toml; say which display with --display")
    given = margin_of(folder) if margin is None else (margin, margin)
    views = simulate(layers, shown_on, shown_on.margin if given is None else given)
    with whole_directory(out, force=force) as temporary:
        write_views(temporary / "views", views, shown_on, bits)
        if array:
            write_views_array(temporary / "views.npy", views, shown_on)
        (temporary / "display.toml").write_text(format_spec(shown_on.spec), "utf-8")
    _out.print(f"{len(views)} views are in {out / 'views'}", soft_wrap=True)


@app.command(name="evaluate")
@_with_field_options
def evaluate_command(
    paths: Annotated[list[str], typer.Argument(metavar="FIELD...", help="light fields")],
    names: Annotated[list[str], typer.Option("--display", help="preset or file; repeatable")],
    wanted: Annotated[str, typer.Option("--methods", help="names, as a,b:100 (iterations)")],
    options: FieldOptions,
    iterations: Iterations = None,
    bits: Bits = 16,
    json: Annotated[Path | None, typer.Option("--json", help="file for the rows")] = None,
    force: Force = False,
) -> None:
    """Compare methods on light fields and displays, the reference beside them."""
    chosen = parse_methods(wanted, iterations)
    models = [Display.load(name) for name in names]
    loaded = [_load(field, options, "cpu") for field in paths]
    for field in loaded:
        for model in models:
            pose(field, model)
    with _file_or_nothing(json, force) as path:
        with _status(total=len(loaded) * len(models) * (len(chosen) + 1)) as tick:
            rows = evaluate(loaded, models, chosen, bits=bits, isolate=True, tick=tick)
        if path is not None:
            write_rows(path, rows)
    _print_tables(rows)


@app.command()
def displays() -> None:
    """List the displays that come with the package."""
    found = [Display.load(name) for name in preset_names()]
    lines = [["name", "link", "views", "layers", "description"]]
    for display in found:
        views = "x".join(map(str, display.geometry.grid or (display.view_count,)))
        lines.append([display.name, display.link.name, views, str(display.layer_count)])
        lines[-1].append(display.spec.description)
    _print_lines(lines)


@app.command()
def methods() -> None:
    """List the methods that make layers."""
    lines = [["name", "iterations", "displays", "summary"]]
    for method in METHODS.values():
        links = ", ".join(method.links)
        lines.append([method.name, str(method.iterations), links, method.summary])
    _print_lines(lines)


def main() -> None:
    """Run the command line; anything wrong is one line on standard error and exit status 2."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # clean up as for Ctrl-C
    try:
        status = app(standalone_mode=False)
    except (KeyboardInterrupt, typer.Abort):
        _fail("interrupted; nothing was written")
    except (ValueError, OSError) as error:
        _fail(str(error))
    except MemoryError:
        _fail("out of memory; take fewer or smaller views (--views, --step, --scale, --crop)")
    except Exception as error:
        # Usage errors of click, whichever copy of click this typer brings along.
        usage = getattr(error, "format_message", None)
        if usage is None:
            raise
        _fail(usage())
    sys.exit(status)


def _fail(message: str) -> NoReturn:
    line = " ".join(message.split())
    sys.stderr.write(f"layerfield: {line}\n")
    sys.exit(2)


def _load(field: str, options: FieldOptions, device: str) -> LightField:
    if device not in ("cpu", "cuda"):
        raise ValueError(f"unknown device '{device}', expected cpu or cuda")
    if device == "cuda" and not torch.cuda.is_available():
        raise ValueError("there is no CUDA device here; use --device cpu")
    loaded = load_light_field(field, options)
    return replace(loaded, views=loaded.views.to(device))


def _recorded(options: FieldOptions) -> dict[str, Any]:
    """Return the options that say what was read, where they are not the default."""
    changed = (f.name for f in fields(options) if getattr(options, f.name) != f.default)
    return {"options": {name: str(getattr(options, name)) for name in changed}}


@contextmanager
def _file_or_nothing(path: Path | None, force: bool) -> Iterator[Path | None]:
    if path is None:
        yield None
        return
    with whole_file(path, force=force) as temporary:
        yield temporary


@contextmanager
def _status(total: int | None = None) -> Iterator[Callable[..., None]]:
    """Show a bar on a terminal, nothing in a pipe; yields tick(what, done)."""
    columns = [SpinnerColumn(), TextColumn("{task.description}"), BarColumn(20)]
    with Progress(
        *columns, TimeElapsedColumn(), console=_err, transient=True, disable=not _err.is_terminal
    ) as progress:
        task = progress.add_task("", total=total)

        def tick(what: str, done: int | None = None) -> None:
            advance = 1 if done is None and total is not None else 0
            progress.update(task, description=what, completed=done, advance=advance or None)

        yield tick


def _report(out: Path, field: LightField, facts: dict[str, Any]) -> None:
    for note in field.notes:
        _out.print(f"note: {note}", soft_wrap=True)
    compared = "; add --reference to see how near that is to the best"
    if facts["reference"] is not None:
        known = facts["reference"]
        compared = f"; {known['kind']} {known['psnr']:.2f} dB, excess {facts['excess']:.1%}"
    figure = "exact" if facts["psnr"] is None else f"{facts['psnr']:.2f} dB"
    interior = "" if facts["psnr"] is None else f" (interior {facts['psnr_interior']:.2f} dB)"
    _out.print(
        f"{facts['method']} on {facts['display']}: {figure}{interior} after "
        f"{facts['iterations']} iterations, {facts['seconds']:.2f} s{compared}",
        soft_wrap=True,
    )
    _out.print(f"{len(facts['layers'])} layers, {facts['bits']} bit, are in {out / 'layers'}")


def _print_tables(rows: list[Row]) -> None:
    for title, lines in tables(rows):
        _out.print(title, style="bold", soft_wrap=True)
        _print_lines(lines)
        _out.print()


def _print_lines(lines: list[list[str]]) -> None:
    grid = Table(*lines[0], box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for line in lines[1:]:
        grid.add_row(*line)
    _out.print(grid)
