"""The command `render`."""

import re
from pathlib import Path
from typing import Annotated, Any

import typer

from layerfield.cli.options import Bits, DisplayName, Force, Out
from layerfield.cli.refusals import depth_asked, keep_inputs, own_file
from layerfield.cli.terminal import say, status
from layerfield.display import Display
from layerfield.io import refuse_existing
from layerfield.panels import largest_code
from layerfield.rendering.job import Job, Quality, render_light_field
from layerfield.rendering.opening import SAMPLE, fingerprint, is_mitsuba, open_scene
from layerfield.rendering.placement import Fit, Pose
from layerfield.rendering.poses import read_poses, turntable
from layerfield.rendering.remarks import remarks
from layerfield.rendering.variant import choose_variant, refuse_missing_extra

_PLACE, _MOVES = "Place", "Animation"
_SCENE = f"model (.glb, .gltf, .obj, .ply, .stl), Mitsuba scene (.xml), or '{SAMPLE}'"
_ELEVATION = 20.0  # degrees from which models are looked down upon

Number = float | None


def render_command(
    scene: Annotated[str, typer.Argument(help=_SCENE)],
    display: DisplayName,
    out: Out,
    size: Annotated[str, typer.Option("--size", help="WxH of a view, pixels")] = "512x384",
    samples: Annotated[
        int, typer.Option("--samples", min=1, help="paths for each pixel: more take noise away")
    ] = 64,
    quick: Annotated[
        bool, typer.Option("--preview", help="only what each pixel sees first, no shadows: seconds")
    ] = False,
    fit: Annotated[
        Number,
        typer.Option(
            "--fit", help="share of the picture for the model; 0.8", rich_help_panel=_PLACE
        ),
    ] = None,
    scale: Annotated[
        Number,
        typer.Option(
            "--scale", help="mm (or px) for one unit of the model, instead", rich_help_panel=_PLACE
        ),
    ] = None,
    depth_mm: Annotated[
        Number,
        typer.Option(
            "--depth-mm", help="depth of what is seen; that of the display", rich_help_panel=_PLACE
        ),
    ] = None,
    depth_px: Annotated[
        Number,
        typer.Option(
            "--depth-px",
            help="the same for displays in pixels of disparity",
            rich_help_panel=_PLACE,
        ),
    ] = None,
    up: Annotated[
        str | None,
        typer.Option("--up", help="axis of the model: y, of STL z", rich_help_panel=_PLACE),
    ] = None,
    azimuth: Annotated[
        float,
        typer.Option("--azimuth", help="degrees the model is turned by", rich_help_panel=_PLACE),
    ] = 0.0,
    elevation: Annotated[
        Number,
        typer.Option(
            "--elevation", help="degrees one looks down; 20, of .xml 0", rich_help_panel=_PLACE
        ),
    ] = None,
    ground: Annotated[
        bool,
        typer.Option("--ground/--no-ground", help="floor and backdrop", rich_help_panel=_PLACE),
    ] = True,
    turns: Annotated[
        int | None,
        typer.Option("--turntable", help="frames of one turn", rich_help_panel=_MOVES),
    ] = None,
    path: Annotated[
        Path | None,
        typer.Option(
            "--path", help="CSV of azimuth,elevation for each frame", rich_help_panel=_MOVES
        ),
    ] = None,
    maps: Annotated[
        bool, typer.Option("--depth", help="write depth and disparity of every view, too")
    ] = False,
    exposure: Annotated[float, typer.Option("--exposure", help="in stops")] = 0.0,
    seed: Annotated[int, typer.Option("--seed", help="of the noise")] = 0,
    bits: Bits = 8,
    resume: Annotated[
        bool, typer.Option("--resume", help="go on with what an earlier run left")
    ] = False,
    force: Force = False,
) -> None:
    """Render a light field of a 3D model for a display."""
    target = Display.load(display)
    largest_code(bits)
    quality = Quality(
        size=_parse_size(size),
        samples=0 if quick else samples,
        exposure=exposure,
        bits=bits,
        seed=seed,
        maps=maps,
    )
    asked = Fit(share=fit, scale=scale, depth=depth_asked(target, depth_mm, depth_px))
    looked = (0.0 if is_mitsuba(scene) else _ELEVATION) if elevation is None else elevation
    poses = _poses(Pose(azimuth, looked), turns, path)
    if not resume:
        refuse_existing(out, force=force)
    keep_inputs(out, None if scene == SAMPLE else scene, own_file(display), path)
    refuse_missing_extra()
    with status(total=len(poses) * target.view_count) as tick:
        tick("starting", 0)
        variant = choose_variant()
        tick("reading", 0)
        source = open_scene(scene, up=up, ground=ground)
        job = Job(source=source, display=target, poses=poses, fit=asked, quality=quality)
        facts = _facts(scene, up, ground)
        render_light_field(out, job, facts, resume=resume, force=force, tick=tick)
    for line in remarks(job, variant):
        say(line)
    frames = f"{len(poses)} frames of " if len(poses) > 1 else ""
    say(f"{frames}{target.view_count} views are in {out}")


def _facts(scene: str, up: str | None, ground: bool) -> dict[str, Any]:
    return {
        "scene": Path(scene).name,
        "scene_sha256": fingerprint(scene),
        "up": up,
        "ground": ground,
    }


def _parse_size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text.strip())
    if match is None:
        raise ValueError(f"size is '{text}', expected WxH in pixels, as 512x384")
    return int(match[2]), int(match[1])


def _poses(start: Pose, turns: int | None, path: Path | None) -> tuple[Pose, ...]:
    if path is not None and turns is not None:
        raise ValueError("--turntable and --path both say how the scene moves; leave out either")
    if path is not None:
        return read_poses(path)
    return (start,) if turns is None else turntable(turns, start)
