"""One batch: frames in, the files of its layers and the figures of its frames out."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from jaxtyping import Float, UInt
from torch import Tensor

from layerfield.display import Display
from layerfield.light_field import LightField
from layerfield.metrics import decibels, finite, mean_square_error
from layerfield.panel_images import panel_images
from layerfield.panels import dequantise
from layerfield.problem import Problem
from layerfield.solve import Solution
from layerfield.solvers.rounding import panel_codes
from layerfield.stream import synthesize_frames
from layerfield.synthesizer import pose
from layerfield.video.form import Codes
from layerfield.video.forms import FORMS
from layerfield.video.job import Batch, Job


@dataclass(frozen=True, eq=False)
class Made:
    """What came out of a batch.

    Args:
        batch: which.
        files: their names within the folder of the video, and what they hold.
        rows: figures of every frame, as JSON holds them.
    """

    batch: Batch
    files: dict[str, bytes]
    rows: list[dict[str, Any]]


def make_batch(job: Job, batch: Batch, tick: Callable[[int], None] | None = None) -> Made:
    """Make the layers of a batch.

    Args:
        job: of which it is a part.
        batch: which frames.
        tick: called with the number of every frame that is done.

    Raises:
        ValueError: a frame that cannot be read, is unlike the first, or not for the display.
    """
    form = FORMS[job.form]
    writers = [form.begin(track, batch.first, job.rate) for track in job.tracks]
    rows = []
    for number, (field, solution) in enumerate(_solved(job, batch), batch.first):
        problem = solution.problem or pose(field, job.display)
        codes = panel_codes(
            problem,
            solution.layers,
            bits=job.bits,
            rounding=job.rounding,
            transfer=job.display.transfer,
        )
        pictures = [*_each(codes.unbind(dim=1)), *_panels(problem, solution, job.display)]
        for writer, picture in zip(writers, pictures, strict=True):
            writer.add(number, picture)
        light = dequantise(codes, job.display.transfer)
        error = _error(light, field, job.display)
        rows.append(_figures(number, solution, error, lossy=form.lossy))
        if tick is not None:
            tick(number)
    files = {name: data for writer in writers for name, data in writer.files().items()}
    return Made(batch, files, rows)


def _solved(job: Job, batch: Batch) -> Iterator[tuple[LightField, Solution]]:
    """Yield the frames of a batch and their layers; those of its run-in are made first."""
    begin = max(job.frames[0], batch.first - job.run_in)
    read: deque[LightField] = deque()

    def kept() -> Iterator[LightField]:
        for field in job.fields(begin, batch.stop):
            read.append(field)
            yield field

    solutions = synthesize_frames(kept(), job.display, method=job.method, iterations=job.iterations)
    for number, solution in enumerate(solutions, begin):
        field = read.popleft()
        if number >= batch.first:
            yield field, solution


def _panels(problem: Problem, solution: Solution, display: Display) -> Iterator[Codes]:
    if display.panels:
        yield from _each(panel_images(problem, solution.layers, display).codes)


def _each(pictures: Iterable[UInt[Tensor, "subframe c _ _"]]) -> Iterator[Codes]:
    """Yield the subframes of every picture, in the order of the tracks of a job."""
    for subframes in pictures:
        yield from subframes


def _error(
    light: Float[Tensor, "subframe layer c ly lx"], field: LightField, display: Display
) -> float:
    """Return the mean square error of what written layers show, as encoded in files."""
    errors = [
        mean_square_error(display.transfer.encode(display.view(light, i)), field.view(i))
        for i in range(len(field))
    ]
    return sum(errors) / len(errors)


def _figures(number: int, solution: Solution, error: float, *, lossy: bool) -> dict[str, Any]:
    when = "_before_compression" if lossy else ""
    row = {
        "frame": number,
        f"psnr{when}": decibels(error),
        f"mean_square_error{when}": error,
        "iterations": solution.iterations,
        "seconds": solution.seconds,
        **solution.details,
    }
    return finite(row)
