"""The command line: options in, one call each, tables out. One line and status 2 for errors."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from layerfield.cli.bench import bench_command
from layerfield.cli.convert import convert_command
from layerfield.cli.design import design_command
from layerfield.cli.evaluate import evaluate_command
from layerfield.cli.info import info_command
from layerfield.cli.lists import displays, methods, weights
from layerfield.cli.options import Force, Out
from layerfield.cli.process import run
from layerfield.cli.render import render_command
from layerfield.cli.report import report_command
from layerfield.cli.reproduce import reproduce_command
from layerfield.cli.rgbd import rgbd_command
from layerfield.cli.simulate import simulate_command
from layerfield.cli.synth import synth_command
from layerfield.cli.terminal import print_tables, say, status
from layerfield.cli.train import train_command
from layerfield.cli.video import video_command
from layerfield.cli.view import view_command
from layerfield.demo import DISPLAYS, run_demo
from layerfield.version import __version__

app = typer.Typer(
    name="layerfield",
    help="Layer images for layered light field displays.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


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
    say(f"look around with: layerfield view {shlex.join(str(out / name) for name in DISPLAYS)}")


app.command(name="info")(info_command)
app.command(name="render")(render_command)
app.command(name="rgbd")(rgbd_command)
app.command(name="convert")(convert_command)
app.command(name="synth")(synth_command)
app.command(name="video")(video_command)
app.command(name="simulate")(simulate_command)
app.command(name="evaluate")(evaluate_command)
app.command(name="bench")(bench_command)
app.command(name="view")(view_command)
app.command(name="report")(report_command)
app.command(name="displays")(displays)
app.command(name="methods")(methods)
app.command(name="design")(design_command)
app.command(name="train")(train_command)
app.command(name="reproduce")(reproduce_command)
app.command(name="weights")(weights)


def main() -> None:
    """Run the command line."""
    run(app)
