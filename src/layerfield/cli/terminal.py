"""What the command line shows: lines, tables, a bar on a terminal, quiet in a pipe."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from layerfield.evaluate import Row, tables
from layerfield.kernels.preparation import PREPARATION
from layerfield.light_field import LightField

_PIPE_WIDTH = 200  # tables in a pipe are not squeezed into 80 columns
_COMPILING = "compiling for this processor, once: about a minute"
_out = Console(highlight=False, markup=False, emoji=False)  # paths may hold [ and :
_err = Console(stderr=True, highlight=False, markup=False, emoji=False)
if not _out.is_terminal:
    _out.width = _PIPE_WIDTH


def say(line: str) -> None:
    """Print a line, however long, to standard output."""
    _out.print(line, soft_wrap=True)


def complain(line: str) -> None:
    """Print a line, however long, to standard error."""
    _err.print(line, soft_wrap=True)


@contextmanager
def status(total: int | None = None) -> Iterator[Callable[..., None]]:
    """Show a bar on a terminal, nothing in a pipe; yields tick(what, done)."""
    columns = [SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(20)]
    with Progress(
        *columns, TimeElapsedColumn(), console=_err, transient=True, disable=not _err.is_terminal
    ) as progress:
        task = progress.add_task("", total=total)

        shown = ""

        def tick(what: str, done: int | None = None) -> None:
            nonlocal shown
            shown, advance = what, 1 if done is None and total is not None else 0
            progress.update(task, description=what, completed=done, advance=advance or None)

        def tell(compiling: bool) -> None:
            progress.update(task, description=_COMPILING if compiling else shown)

        with PREPARATION.told(tell):
            yield tick


def report(out: Path, field: LightField, facts: dict[str, Any]) -> None:
    """Say what synthesis reached, beside the reference if there is one."""
    for note in field.notes:
        say(f"note: {note}")
    light = facts["psnr_linear"] != facts["psnr"]
    compared = "; add --reference to see how near that is to the best"
    if facts["reference"] is not None:
        known = facts["reference"]
        excess = "" if facts["excess"] is None else f", excess {facts['excess']:.1%}"
        where = " in linear light" if light else ""
        compared = f"; {known['kind']} {_decibels(known['psnr'])}{where}{excess}"
    linear = f", linear light {_decibels(facts['psnr_linear'])}" if light else ""
    observers = (
        f", as observers count {_decibels(facts['psnr_observers'])}"
        if "psnr_observers" in facts
        else ""
    )
    say(
        f"{facts['method']} on {facts['display']}: {_decibels(facts['psnr'])} (interior "
        f"{_decibels(facts['psnr_interior'])}{linear}{observers}) after {_effort(facts)}{compared}"
    )
    say(f"{len(facts['layers'])} layers, {facts['bits']} bit, are in {out / 'layers'}")
    if "panels" in facts:
        _report_panels(out, facts["panels"])


def _report_panels(out: Path, found: dict[str, Any]) -> None:
    differ = found["psnr_linear"] != found["psnr"]
    linear = f" (linear light {_decibels(found['psnr_linear'])})" if differ else ""
    missed = max(found["missed"])
    dark = f"; up to {missed:.1%} of the light paths miss one and are dark" if missed else ""
    say(f"panels: {_decibels(found['psnr'])}{linear}, pictures in {out / 'panels'}{dark}")


def _effort(facts: dict[str, Any]) -> str:
    """Iterations and seconds; of a network, what had to be clamped."""
    iterations, seconds = f"{facts['iterations']} iterations", f"{facts['seconds']:.2f} s"
    if "clamped" not in facts["details"]:
        return f"{iterations}, {seconds}"
    more = f" and {iterations}" if facts["iterations"] else ""
    share = f"{facts['details']['clamped']:.1%}".replace("%", " %")
    return f"one forward pass{more}, {seconds}, {share} of layer pixels clamped"


def _decibels(value: float | None) -> str:
    return "exact" if value is None else f"{value:.2f} dB"


def print_tables(rows: list[Row]) -> None:
    """Print a table for each light field and display."""
    for title, lines in tables(rows):
        _out.print(title, style="bold", soft_wrap=True)
        print_lines(lines)
        _out.print()


def print_lines(lines: list[list[str]]) -> None:
    """Print a table, its heading first."""
    grid = Table(*lines[0], box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for line in lines[1:]:
        grid.add_row(*line)
    _out.print(grid)
