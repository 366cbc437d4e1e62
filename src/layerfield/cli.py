"""The command line: options in, one call each, tables out. One line and status 2 for errors."""

import inspect
import io
import re
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, NoReturn

import torch
import typer

from layerfield.demo import run_demo
from layerfield.disparity import estimate_disparity
from layerfield.display import Display, preset_names
from layerfield.display_spec import format_spec
from layerfield.evaluate import evaluate, parse_methods, write_rows
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
from layerfield.io.images import SUFFIXES
from layerfield.light_field import LightField
from layerfield.nearest import did_you_mean
from layerfield.panels import largest_code
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
from layerfield.solvers.rounding import ROUNDINGS
from layerfield.synthesizer import METHODS, find_method, pose, synthesize
from layerfield.terminal import complain, print_lines, print_tables, report, say, status
from layerfield.version import __version__

app = typer.Typer(
    name="layerfield",
    help="Layer images for layered light field displays.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
_SMALLEST = 11  # pixels of a view, the window of SSIM
_DEVICES = ("cpu", "cuda")
_NO_MEMORY = re.compile("out of memory|allocate memory")  # of PyTorch's RuntimeErrors
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

Field = Annotated[str, typer.Argument(help="folder of views, picture, .npy, .npz or .h5")]
Out = Annotated[Path, typer.Option("--out", help="folder to make")]
Force = Annotated[bool, typer.Option("--force", help="replace an earlier result")]
Bits = Annotated[int, typer.Option("--bits", help="of the images that are written: 8 or 16")]
DisplayName = Annotated[str, typer.Option("--display", help="a preset or a TOML file")]
Device = Annotated[str, typer.Option("--device", help="cpu or cuda")]
Iterations = Annotated[
    int | None, typer.Option("--iterations", min=0, help="the method's own if not given")
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
@_with_field_options
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
    _keep_inputs(path, field)
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
    # What can be refused is refused before the work, not after it.
    target, count = Display.load(display), find_method(method).iterations
    count = count if iterations is None else iterations
    largest_code(bits)
    _refuse_unknown("rounding", rounding, ROUNDINGS)
    refuse_existing(out, force=force)
    _keep_inputs(out, field, _own_file(display))
    with status(total=count) as tick:
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
    bits: Bits = 8,
    array: Annotated[
        bool, typer.Option("--array", help="write views.npy, unclipped float32, as well")
    ] = False,
    force: Force = False,
) -> None:
    """Write the views that viewers of these layers see."""
    largest_code(bits)
    refuse_existing(out, force=force)
    _keep_inputs(out, folder, _own_file(display))
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
    say(f"{len(views)} views are in {out / 'views'}")


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
    largest_code(bits)
    models = [Display.load(name) for name in names]
    _refuse_repeats("displays", [model.name for model in models])
    for model in models:
        _refuse_unserved(model, [name for name, _ in chosen])
    loaded = _told_apart([_load(field, options, "cpu") for field in paths], paths)
    for field in loaded:
        for model in models:
            pose(field, model)
    if json is not None:
        _keep_inputs(json, *paths, *map(_own_file, names))
    with _file_or_nothing(json, force) as path:
        with status(total=len(loaded) * len(models) * (len(chosen) + 1)) as tick:
            rows = evaluate(loaded, models, chosen, bits=bits, isolate=True, tick=tick)
        if path is not None:
            write_rows(path, rows)
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


def main() -> None:
    """Run the command line; anything wrong is one line on standard error and exit status 2."""
    _prepare()
    try:
        status = app(standalone_mode=False)
    except (_Interrupted, typer.Abort):
        _fail("interrupted; nothing is half-written")
    except (ValueError, OSError) as error:
        _fail(str(error))
    except Exception as error:
        _fail(_expected(error))
    sys.exit(status)


class _Interrupted(BaseException):
    """A signal asked to stop. Typer would turn a KeyboardInterrupt into an exit of its own."""


def _prepare() -> None:
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as under nohup
            signal.signal(number, _interrupt)
    if isinstance(sys.stdout, io.TextIOWrapper):  # file names may hold what it cannot print
        sys.stdout.reconfigure(errors="backslashreplace")


def _interrupt(*_: object) -> NoReturn:
    for number in _SIGNALS:  # a second one must not disturb the cleaning up
        signal.signal(number, signal.SIG_IGN)
    raise _Interrupted


def _expected(error: Exception) -> str:
    """Return the line for errors that are not ValueErrors; raise those that nobody expects."""
    if isinstance(error, MemoryError) or _NO_MEMORY.search(str(error)):
        return "out of memory; take fewer or smaller views (--views, --step, --scale, --crop)"
    # Usage errors of click, whichever copy of click this typer brings along.
    usage = getattr(error, "format_message", None)
    if usage is None:
        raise error
    return usage() or "no command given; see layerfield --help"


def _fail(message: str) -> NoReturn:
    line = " ".join(message.split())
    complain(f"layerfield: {line}")
    sys.exit(2)


def _refuse_unknown(what: str, name: str, known: Sequence[str]) -> None:
    if name not in known:
        raise ValueError(f"unknown {what} '{name}'{did_you_mean(name, known)}")


def _refuse_repeats(what: str, names: list[str]) -> None:
    for name, count in Counter(names).items():
        if count > 1:
            raise ValueError(
                f"found {count} {what} called '{name}'; give each once, by a name of its own"
            )


def _refuse_unserved(display: Display, names: list[str]) -> None:
    for name in names:
        links = find_method(name).links
        if display.link.name not in links:
            raise ValueError(
                f"method '{name}' serves {' and '.join(links)} displays, '{display.name}' is "
                f"{display.link.name}; leave one of them out"
            )


def _keep_inputs(out: Path, *inputs: str | Path | None) -> None:
    """Refuse to replace what is read, even by force, or to put a picture among the views."""
    for given in (Path(name) for name in inputs if name and Path(name).exists()):
        source, place = given.resolve(), out.resolve()
        among = place.parent == source and place.suffix.lower() in SUFFIXES
        if among or (out.exists() and source.is_relative_to(place)):
            raise ValueError(f"{out} is, holds or lies among the input {given}; give another name")


def _own_file(display: str | None) -> str | None:
    return None if display in preset_names() else display


def _told_apart(loaded: list[LightField], paths: list[str]) -> list[LightField]:
    """Name light fields by their folder, too, where their names are the same."""
    names = Counter(field.name for field in loaded)
    apart = [
        replace(field, name=f"{Path(path).resolve().parent.name}/{field.name}")
        if names[field.name] > 1
        else field
        for field, path in zip(loaded, paths, strict=True)
    ]
    _refuse_repeats("light fields", [field.name for field in apart])
    return apart


def _load(field: str, options: FieldOptions, device: str) -> LightField:
    _refuse_unknown("device", device, _DEVICES)
    if device == "cuda" and not torch.cuda.is_available():
        raise ValueError("there is no CUDA device here; use --device cpu")
    loaded = load_light_field(field, options)
    if min(loaded.size) < _SMALLEST:
        height, width = loaded.size
        raise ValueError(
            f"the views of '{loaded.name}' are {width}x{height} px, expected at least "
            f"{_SMALLEST}x{_SMALLEST}; take larger ones"
        )
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
