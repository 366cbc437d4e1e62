"""The command `simulate`."""

from pathlib import Path
from typing import Annotated

import typer

from layerfield.cli.options import Bits, Force, Out
from layerfield.cli.refusals import keep_inputs, own_file
from layerfield.cli.terminal import say
from layerfield.display import Display
from layerfield.display_spec import format_spec
from layerfield.eyes import Eye, look, write_eyes
from layerfield.io import refuse_existing, whole_directory
from layerfield.panels import largest_code
from layerfield.remarks import made_for_another_transfer
from layerfield.result import write_views, write_views_array
from layerfield.stored_result import (
    display_of,
    margin_of,
    mount,
    read_layers,
    read_panels,
    simulate_panels,
    view_size_of,
)

_EYE = "X,Y[,Z] in mm, or X,Y in view steps: what an eye there sees; repeatable"


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
