"""The command `simulate`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from jaxtyping import Float
from torch import Tensor

from layerfield.animation import PATHS, Sweep, animate
from layerfield.cli.options import Bits, Force
from layerfield.cli.outputs import file_or_nothing, folder_or_nothing
from layerfield.cli.refusals import keep_inputs, own_file, refuse_without
from layerfield.cli.terminal import say, status
from layerfield.display import Display
from layerfield.display_spec import format_spec
from layerfield.eyes import Eye, write_eyes
from layerfield.io import refuse_animation, refuse_existing, write_animation
from layerfield.panels import largest_code
from layerfield.remarks import made_for_another_transfer
from layerfield.result import write_views, write_views_array
from layerfield.simulation import mounted, views_shown
from layerfield.stored_result import display_of, read_layers

_EYE = "X,Y[,Z] in mm, or X,Y in view steps: what an eye there sees; repeatable"
_VIDEO = "file to make of what a moving eye sees: .mp4, .webp or .gif"
_PANEL = "Animation"


def simulate_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="a result, or layer images")],
    out: Annotated[Path | None, typer.Option("--out", help="folder to make of views")] = None,
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
    video: Annotated[
        Path | None, typer.Option("--video", help=_VIDEO, rich_help_panel=_PANEL)
    ] = None,
    sweep: Annotated[
        str | None,
        typer.Option(
            "--sweep", help=f"path of the eye: {' or '.join(PATHS)}", rich_help_panel=_PANEL
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option("--seconds", help="until it starts again; 4", rich_help_panel=_PANEL),
    ] = None,
    fps: Annotated[
        float | None, typer.Option("--fps", help="frames a second; 30", rich_help_panel=_PANEL)
    ] = None,
    width: Annotated[
        int | None,
        typer.Option(
            "--width", help="of the frames, pixels; that of the views", rich_help_panel=_PANEL
        ),
    ] = None,
    force: Force = False,
) -> None:
    """Write the views that viewers of these layers see; or what eyes see, at rest or moving."""
    largest_code(bits)
    moves: dict[str, Any] = {"seconds": seconds, "fps": fps}
    refuse_without("--video", video, {"sweep": sweep, "width": width, **moves})
    refuse_without("--out", out, {"eye": eye or None, "array": array or None})
    moves["path"] = sweep
    motion = Sweep(**{name: value for name, value in moves.items() if value is not None})
    _refuse_outputs(out, video, motion, force=force)
    for place in filter(None, (out, video)):
        keep_inputs(place, folder, own_file(display))
    if video is not None:
        keep_inputs(video, *folder.glob("**/"))  # pictures there would pass for layers
    layers, made_for = read_layers(folder), display_of(folder)
    shown_on = made_for if display is None else Display.load(display)
    if shown_on is None:
        raise ValueError(f"{folder} holds no display.toml; say which display with --display")
    eyes = [Eye.parse(text, shown_on) for text in eye or ()]
    done = []
    with file_or_nothing(video, force=force) as file, folder_or_nothing(out, force=force) as made:
        if out and made:
            views = views_shown(folder, layers, shown_on, eyes, margin)
            _write_views(made, views, shown_on, eyes, bits, array=array)
            done.append(f"{_count(len(views), 'view')} in {out / 'views'}")
        if file:
            frames = animate(mounted(folder, layers, shown_on, margin), shown_on, motion, width)
            with status(total=len(frames)) as tick:
                write_animation(file, frames, motion.fps, tick)
            done.append(f"{_count(len(frames), 'frame')} in {video}")
    for line in [*made_for_another_transfer(made_for, shown_on), *done]:
        say(line)


def _refuse_outputs(out: Path | None, video: Path | None, motion: Sweep, *, force: bool) -> None:
    if out is None and video is None:
        raise ValueError("nothing to make: give --out for views, or --video for an animation")
    if out is not None:
        refuse_existing(out, force=force)
    if video is not None:
        refuse_animation(video, motion.fps)
    if out is not None and video is not None and video.resolve().is_relative_to(out.resolve()):
        raise ValueError(f"{video} lies in {out}, which is made anew; give another name")


def _write_views(
    folder: Path,
    views: Float[Tensor, "view c y x"],
    display: Display,
    eyes: Sequence[Eye],
    bits: int,
    *,
    array: bool,
) -> None:
    if eyes:
        write_eyes(folder / "views", views, bits)
    else:
        write_views(folder / "views", views, display, bits)
    if array:
        grid = (1, len(eyes)) if eyes else display.geometry.grid or (1, len(views))
        write_views_array(folder / "views.npy", views, grid)
    (folder / "display.toml").write_text(format_spec(display.spec), "utf-8")


def _count(number: int, what: str) -> str:
    return f"1 {what} is" if number == 1 else f"{number} {what}s are"
