"""The command `video`."""

import re
import statistics
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Annotated

import typer

from layerfield.cli.options import (
    Bits,
    DisplayName,
    Force,
    Out,
    recorded,
    with_field_options,
)
from layerfield.cli.refusals import (
    DEVICES,
    keep_inputs,
    own_file,
    refuse_device,
    refuse_unknown,
)
from layerfield.cli.terminal import say, status
from layerfield.display import Display
from layerfield.frames.opening import open_frames
from layerfield.frames.source import FrameSource
from layerfield.io import FieldOptions, refuse_existing
from layerfield.methods import Method, SolverMethod
from layerfield.metrics import decibels
from layerfield.panel_images import panel_projection
from layerfield.remarks import values_taken_for_light
from layerfield.solvers.rounding import ROUNDINGS
from layerfield.stream import WARM_ITERATIONS
from layerfield.synthesizer import find_method, pose
from layerfield.video.forms import FORMS
from layerfield.video.job import BATCH, Job
from layerfield.video.making import Maker, make_here, make_video, read_figures
from layerfield.video.on_ray import ray_at

_INPUT = "folder of frames, pattern (quilt_%04d.png, take_*), or video of quilts or atlases"
_METHOD = "a name that `methods` lists, FILE.safetensors, or NETWORK+SOLVER"
_FORMATS = ", ".join(f"{name}: {form.title}" for name, form in FORMS.items())
_WRITING, _WORKERS = "Writing", "Many processors and machines"
_RATE = Fraction(25)  # frames a second, where nobody says
_SLOWEST, _FASTEST = 1, 1000


@with_field_options
def video_command(
    source: Annotated[str, typer.Argument(metavar="INPUT", help=_INPUT)],
    display: DisplayName,
    out: Out,
    options: FieldOptions,
    method: Annotated[str, typer.Option("--method", help=_METHOD)] = "fast",
    iterations: Annotated[
        int | None,
        typer.Option("--iterations", min=0, help=f"of frames behind others: {WARM_ITERATIONS}"),
    ] = None,
    frames: Annotated[
        str | None, typer.Option("--frames", help="FIRST:STOP, from 0; all if not given")
    ] = None,
    form: Annotated[
        str, typer.Option("--format", help=_FORMATS, rich_help_panel=_WRITING)
    ] = "ffv1",
    fps: Annotated[
        str | None,
        typer.Option(
            "--fps", help="frames a second; those of the input, or 25", rich_help_panel=_WRITING
        ),
    ] = None,
    bits: Bits = 8,
    rounding: Annotated[
        str, typer.Option("--rounding", help="of 8-bit layers: joint or nearest")
    ] = "joint",
    batch: Annotated[
        int, typer.Option("--batch", min=1, help="frames that are made, and kept, together")
    ] = BATCH,
    device: Annotated[
        str | None, typer.Option("--device", help="cpu or cuda; with Ray what it has")
    ] = None,
    ray: Annotated[
        str | None,
        typer.Option(
            "--ray", help="local, auto, HOST:PORT or ray://HOST:PORT", rich_help_panel=_WORKERS
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers", min=1, help="of Ray; as many as it has room for", rich_help_panel=_WORKERS
        ),
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option("--threads", min=1, help="of each worker of Ray; 1", rich_help_panel=_WORKERS),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="go on with what an earlier run left")
    ] = False,
    force: Force = False,
) -> None:
    """Make the layers of every frame of a light field video."""
    target, chosen = Display.load(display), find_method(method)
    count = _iterations(chosen, iterations)
    _refuse_form(form, bits, target)
    refuse_unknown("rounding", rounding, ROUNDINGS)
    _refuse_without_ray(ray, workers, threads)
    if ray is None:
        refuse_device(device or "cpu")
    elif device is not None:
        refuse_unknown("device", device, DEVICES)
    if not resume:
        refuse_existing(out, force=force)
    keep_inputs(out, source, own_file(display), chosen.file)
    chosen.refuse_unserved(target)
    with status() as tick:
        tick("reading")
        found = open_frames(source, options)
    with _makers(ray, workers, threads, device) as (make, place):
        job = Job(
            source=found,
            frames=_parse_frames(frames, found),
            spec=target.spec,
            method=method,
            iterations=count,
            form=form,
            bits=bits,
            rounding=rounding,
            rate=_parse_rate(fps) or found.rate or _RATE,
            length=batch,
            device=place,
        )
        _refuse_misfit(job)
        for note in _remarks(job):
            say(note)
        with status(total=job.count_without([])) as tick:
            facts = recorded(options)
            make_video(out, job, facts, make=make, resume=resume, force=force, tick=tick)
    _report(out, job)


@contextmanager
def _makers(
    address: str | None, workers: int | None, threads: int | None, device: str | None
) -> Iterator[tuple[Maker, str]]:
    """Yield who makes batches, and on which device."""
    if address is None:
        yield make_here, device or "cpu"
        return
    with status() as tick:
        tick("starting Ray")
        started = ExitStack()
        ray = started.enter_context(
            ray_at(address, workers=workers, threads=threads or 1, device=device)
        )
    with started:
        yield ray, ray.device


def _refuse_without_ray(address: str | None, workers: int | None, threads: int | None) -> None:
    for name, value in (("workers", workers), ("threads", threads)):
        if address is None and value is not None:
            raise ValueError(f"--{name} is about the workers of Ray; give --ray, too")


def _iterations(method: Method, asked: int | None) -> int:
    """Iterations of every frame that has one before; other methods know no such frames."""
    if isinstance(method, SolverMethod):
        return WARM_ITERATIONS if asked is None else asked
    if asked not in (None, method.iterations):
        raise ValueError(
            f"method '{method.name}' starts anew in every frame and makes {method.iterations} "
            "iterations; leave --iterations out"
        )
    return method.iterations


def _refuse_form(form: str, bits: int, display: Display) -> None:
    refuse_unknown("format", form, list(FORMS))
    FORMS[form].refuse_missing()
    for found in (bits, *(panel.bits for panel in display.panels)):
        if found not in FORMS[form].bits:
            kept = " or ".join(map(str, FORMS[form].bits))
            raise ValueError(f"format {form} keeps {kept} bits, found {found}; take ffv1 or png")


def _refuse_misfit(job: Job) -> None:
    """Refuse a display that the first frame is not for."""
    pose(job.opening, job.display)
    if job.display.panels:
        panel_projection(job.display, job.opening.size)


def _parse_frames(text: str | None, source: FrameSource) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{0,9}):(\d{0,9})", ":" if text is None else text.strip())
    if match is None:
        raise ValueError(f"frames is '{text}', expected FIRST:STOP as 0:48, or 100: for the rest")
    return int(match[1] or 0), int(match[2] or source.count)


def _parse_rate(text: str | None) -> Fraction | None:
    if text is None:
        return None
    if re.fullmatch(r"\d{1,6}(\.\d{1,6}|/[1-9]\d{0,5})?", text.strip()):
        rate = Fraction(text.strip())
        if _SLOWEST <= rate <= _FASTEST:
            return rate
    raise ValueError(
        f"fps is '{text}', expected {_SLOWEST} to {_FASTEST} frames a second, as 24 or 30000/1001"
    )


def _remarks(job: Job) -> list[str]:
    notes = [f"note: {note}" for note in (*job.source.notes, *job.opening.notes)]
    notes += values_taken_for_light(job.opening, job.display)
    height, width = (n + 2 * m for n, m in zip(job.opening.size, job.display.margin, strict=True))
    if FORMS[job.form].lossy and (height % 2 or width % 2):
        notes.append(
            f"note: the layers are {width}x{height} px; {job.form} has even sizes only, so the "
            "last column or row is repeated"
        )
    return notes


def _report(out: Path, job: Job) -> None:
    rows, lossy = read_figures(out), FORMS[job.form].lossy
    errors = [row[f"mean_square_error{'_before_compression' * lossy}"] for row in rows]
    worst = rows[errors.index(max(errors))]
    seconds = statistics.fmean(row["seconds"] for row in rows)
    say(
        f"{len(rows)} frames by {find_method(job.method).title} on {job.display.name}: "
        f"{decibels(statistics.fmean(errors)):.2f} dB, the worst {decibels(max(errors)):.2f} dB "
        f"(frame {worst['frame']}){', before compression' * lossy}; {seconds:.2f} s a frame"
    )
    say(f"{len(job.tracks)} tracks, {FORMS[job.form].title}, are in {out}")
