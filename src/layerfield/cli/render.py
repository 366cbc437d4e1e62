"""The command `render`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from layerfield.cli.options import DisplayName, Force, Out, with_grouped_options
from layerfield.cli.refusals import keep_inputs, own_file
from layerfield.cli.render_options import MoveOptions, PlaceOptions, QualityOptions
from layerfield.cli.terminal import say, status
from layerfield.display import Display
from layerfield.io import refuse_existing
from layerfield.rendering.job import Job, render_light_field
from layerfield.rendering.opening import SAMPLE, fingerprint, open_scene
from layerfield.rendering.remarks import remarks
from layerfield.rendering.variant import choose_variant, refuse_missing_extra, start_trial

_SCENE = f"model (.glb, .gltf, .obj, .ply, .stl), Mitsuba scene (.xml), or '{SAMPLE}'"


@with_grouped_options
def render_command(
    scene: Annotated[str, typer.Argument(help=_SCENE)],
    display: DisplayName,
    out: Out,
    quality: QualityOptions,
    place: PlaceOptions,
    moves: MoveOptions,
    resume: Annotated[
        bool, typer.Option("--resume", help="go on with what an earlier run left")
    ] = False,
    force: Force = False,
) -> None:
    """Render a light field of a 3D model for a display."""
    target = Display.load(display)
    asked = quality.parsed()
    fit = place.fit_to(target)
    poses = moves.poses(place.pose(scene))
    if not resume:
        refuse_existing(out, force=force)
    keep_inputs(out, None if scene == SAMPLE else scene, own_file(display), moves.path)
    trial = start_trial()
    refuse_missing_extra()
    with status(total=len(poses) * target.view_count) as tick:
        tick("starting", 0)
        variant = choose_variant(trial)
        tick("reading", 0)
        source = open_scene(scene, up=place.up, ground=place.ground)
        job = Job(source=source, display=target, poses=poses, fit=fit, quality=asked)
        facts = _facts(scene, place)
        render_light_field(out, job, facts, resume=resume, force=force, tick=tick)
    for line in remarks(job, variant):
        say(line)
    frames = f"{len(poses)} frames of " if len(poses) > 1 else ""
    say(f"{frames}{target.view_count} views are in {out}")


def _facts(scene: str, place: PlaceOptions) -> dict[str, Any]:
    return {
        "scene": Path(scene).name,
        "scene_sha256": fingerprint(scene),
        "up": place.up,
        "ground": place.ground,
    }
