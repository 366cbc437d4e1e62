"""A whole video of layers: batch after batch is kept, what is there is not made again.

OUT/layers/layer_0.mkv ...   a video of every layer, the nearest to the viewer first, margin
                             included; of pictures OUT/frame_000000/layers/layer_0.png ...
OUT/panels/panel_0.mkv ...   of every panel, if the display has any
OUT/display.toml             the display they are for
OUT/frames.jsonl             figures of every frame, a line each
OUT/video.json               what was made of what, and how
"""

import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from layerfield.display_spec import format_spec
from layerfield.io import whole_file
from layerfield.io.resumable_output import is_made, resumable_directory
from layerfield.video.form import PARTS
from layerfield.video.forms import FORMS
from layerfield.video.job import Batch, Job
from layerfield.video.work import Made, make_batch

RECORD, FIGURES = "video.json", "frames.jsonl"
Tick = Callable[[str, int], None]
Maker = Callable[[Job, Sequence[Batch], Tick], Iterable[Made]]


def make_here(job: Job, batches: Sequence[Batch], tick: Tick) -> Iterator[Made]:
    """Make batches in this process, one after the other."""
    done = job.count_without(batches)
    for batch in batches:
        base = done - batch.first
        yield make_batch(job, batch, lambda n, base=base: tick("frames", base + n + 1))
        done += batch.stop - batch.first


def make_video(
    folder: str | Path,
    job: Job,
    facts: dict[str, Any],
    *,
    make: Maker = make_here,
    resume: bool = False,
    force: bool = False,
    tick: Tick = lambda what, done: None,
) -> None:
    """Make the layers of a video in a folder, which appears when it is complete.

    Args:
        folder: to be made.
        job: what is made of what.
        facts: for the record, on top of those of the job.
        make: who makes batches; in any order.
        resume: go on with the batches that an earlier run left; layers end as in a single run.
        force: replace an earlier folder.
        tick: called with a word and the number of frames that are done.

    Raises:
        ValueError: as `resumable_directory` does, or a frame that cannot be made; the batches that
            are done stay for another try.
    """
    facts = {**facts, **job.facts()}
    if resume and is_made(folder, RECORD, facts):
        return
    with resumable_directory(folder, RECORD, facts, resume=resume, force=force) as work:
        with whole_file(work / "display.toml", force=True) as temporary:
            temporary.write_text(format_spec(job.spec), "utf-8")
        if not (work / FIGURES).is_file():
            _make_missing(work, job, make, tick)
            tick("joining", job.count_without([]))
            _join(work, job)
        shutil.rmtree(work / PARTS, ignore_errors=True)


def read_figures(folder: str | Path) -> list[dict[str, Any]]:
    """Read the figures of all frames of a video, in order."""
    lines = (Path(folder) / FIGURES).read_text("utf-8").splitlines()
    return [json.loads(line) for line in lines]


def _make_missing(work: Path, job: Job, make: Maker, tick: Tick) -> None:
    missing = [batch for batch in job.batches if not _rows_of(work, batch).is_file()]
    try:
        for made in make(job, missing, tick):
            _keep(work, made)
    except ValueError as error:
        missing = [batch for batch in job.batches if not _rows_of(work, batch).is_file()]
        raise ValueError(
            f"{error}; {job.count_without(missing)} of {job.count_without([])} frames are done "
            f"and stay in {work.name}, go on with --resume"
        ) from None


def _rows_of(work: Path, batch: Batch) -> Path:
    return work / PARTS / f"{batch.first:09d}.jsonl"


def _keep(work: Path, made: Made) -> None:
    """Write what came out of a batch; its figures last, they say that all of it is there."""
    for name, data in made.files.items():
        _write(work / name, data)
    lines = [json.dumps(row) + "\n" for row in made.rows]
    _write(_rows_of(work, made.batch), "".join(lines).encode())


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path, force=True) as temporary:
        temporary.write_bytes(data)


def _join(work: Path, job: Job) -> None:
    """Join the parts; the figures last, they say that nothing is left to do."""
    firsts = [batch.first for batch in job.batches]
    FORMS[job.form].join(work, job.tracks, firsts, job.rate)
    figures = b"".join(_rows_of(work, batch).read_bytes() for batch in job.batches)
    _write(work / FIGURES, figures)
