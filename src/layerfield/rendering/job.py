"""A light field, or one for every frame, rendered into a folder view by view."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.display import Display
from layerfield.display_spec import format_spec
from layerfield.io import whole_file, write_png
from layerfield.io.resumable_output import is_made, resumable_directory
from layerfield.panels import quantise
from layerfield.provenance import provenance
from layerfield.rendering.placement import Fit, Placement, Pose, in_disparities
from layerfield.rendering.previews import preview
from layerfield.rendering.sources import Source
from layerfield.rendering.takes import Take
from layerfield.rendering.tracing import first_hits, trace
from layerfield.rendering.variant import mitsuba
from layerfield.transfer import NONE, Srgb

RECORD = "render.json"
_LARGEST, _SMALLEST = 8192, 8  # pixels along a side
_MOST_SAMPLES = 65_536
_MOST_STOPS = 20.0


@dataclass(frozen=True, kw_only=True)
class Quality:
    """How views are rendered.

    Args:
        size: height and width of a view, in pixels.
        samples: paths for each pixel; 0 for a preview, without shadows.
        exposure: in stops, twice the light each.
        bits: of the pictures, 8 or 16.
        seed: of the noise.
        maps: whether depth and disparity of every view are written, too.
    """

    size: tuple[int, int] = (384, 512)
    samples: int = 64
    exposure: float = 0.0
    bits: int = 8
    seed: int = 0
    maps: bool = False

    def __post_init__(self) -> None:
        if not all(_SMALLEST <= side <= _LARGEST for side in self.size):
            raise ValueError(
                f"the views are {self.size[1]}x{self.size[0]} px, expected {_SMALLEST} to "
                f"{_LARGEST} along each side"
            )
        if not 0 <= self.samples <= _MOST_SAMPLES:
            raise ValueError(f"found {self.samples} samples, expected 1 to {_MOST_SAMPLES}")
        if not abs(self.exposure) <= _MOST_STOPS:
            raise ValueError(
                f"the exposure is {self.exposure:g} stops, expected -{_MOST_STOPS:g} to "
                f"{_MOST_STOPS:g}"
            )
        if self.seed < 0:
            raise ValueError(f"the seed is {self.seed}, expected 0 or more")


@dataclass(frozen=True, eq=False, kw_only=True)
class Job:
    """What is rendered, for which display, and how.

    Args:
        source: what is seen.
        display: whose viewpoints see it.
        poses: how it is turned, one for every frame.
        fit: how large and how deep it is to appear.
        quality: of the views.
    """

    source: Source
    display: Display
    poses: tuple[Pose, ...]
    fit: Fit
    quality: Quality

    @cached_property
    def placement(self) -> Placement:
        """Where the scene stands in the display."""
        return self.source.place(self.poses, self.display, self.quality.size, self.fit)

    @property
    def view_count(self) -> int:
        """Views of all frames."""
        return len(self.poses) * self.display.view_count

    def facts(self) -> dict[str, Any]:
        """Return what decides on the pictures, for their record."""
        spec = self.display.spec.model_dump(mode="json", exclude_defaults=True)
        placement = self.placement
        far, near = placement.depths
        unit = 1.0 if in_disparities(self.display) else 1e-3
        return {
            "display": spec,
            "quality": asdict(self.quality),
            "fit": asdict(self.fit),
            "poses": [asdict(pose) for pose in self.poses],
            "depth": {
                "unit": "px of disparity" if in_disparities(self.display) else "mm",
                "farthest": far / unit,
                "nearest": near / unit,
                "ground": [placement.gain * z / unit for z in placement.seen],
                "display": [z / unit for z in placement.geometry.depths],
            },
            "disparities": placement.disparities(),
            "pixels_per_unit_of_model": placement.scale,
            "depth_per_pixel": placement.gain / unit,
        }


class _View(NamedTuple):
    """One picture to be made: of which frame, from which viewpoint, its folder and its name."""

    frame: int
    number: int
    folder: Path
    name: str


def render_light_field(
    folder: str | Path,
    job: Job,
    facts: dict[str, Any],
    *,
    resume: bool = False,
    force: bool = False,
    tick: Callable[[str, int], None] | None = None,
) -> None:
    """Render all views into a folder, which appears when it is complete.

    A folder for every frame, `frame_0000` ..., where there are several poses.

    Args:
        folder: to be made.
        job: what is rendered.
        facts: for the record `render.json`, on top of those of the job.
        resume: go on with what an earlier run left; it ends with the same bytes as a single run.
        force: replace an earlier folder.
        tick: called with a word and the number of views that are done.

    Raises:
        ValueError: as `resumable_directory` does, or a view that cannot be rendered.
    """
    facts = {**facts, **job.facts(), "made_with": _made_with()}
    if resume and is_made(folder, RECORD, facts):
        return
    tick = tick or (lambda what, done: None)
    with resumable_directory(folder, RECORD, facts, resume=resume, force=force) as work:
        with whole_file(work / "display.toml", force=True) as temporary:
            temporary.write_text(format_spec(job.display.spec), "utf-8")
        frame, take = -1, None
        for done, view in enumerate(_views(work, job)):
            tick(f"view {done + 1} of {job.view_count}", done)
            if (view.folder / f"view_{view.name}.png").is_file():
                continue
            if take is None or frame != view.frame:
                frame, take = view.frame, job.source.take(job.poses[view.frame], job.placement)
            _make(view, take, job)
            tick(f"view {done + 1} of {job.view_count}", done + 1)


def _views(work: Path, job: Job) -> Iterator[_View]:
    _, columns = job.display.geometry.grid or (1, job.display.view_count)
    for frame in range(len(job.poses)):
        folder = work / f"frame_{frame:04d}" if len(job.poses) > 1 else work
        for number in range(job.display.view_count):
            row, column = divmod(number, columns)
            yield _View(frame, number, folder, f"{row:02d}_{column:02d}")


def _make(view: _View, take: Take, job: Job) -> None:
    """Write the maps first: a picture says that all of a view is there."""
    quality = job.quality
    view.folder.mkdir(exist_ok=True)
    if quality.maps:
        _write_maps(view, take, job)
    if quality.samples:
        seed = (quality.seed, view.frame, view.number)
        light = trace(take, job.placement, view.number, samples=quality.samples, seed=seed)
    else:
        light = preview(take, job.placement, view.number)
    values = _encoded(light * 2.0**quality.exposure, job.display)
    with whole_file(view.folder / f"view_{view.name}.png", force=True) as temporary:
        write_png(temporary, quantise(values, quality.bits))


def _encoded(light: Float[np.ndarray, "y x 3"], display: Display) -> Float[Tensor, "3 y x"]:
    """Return the values of the picture; where a display takes them as they are, those of sRGB."""
    transfer = Srgb() if display.transfer == NONE else display.transfer
    planes = torch.from_numpy(np.ascontiguousarray(np.moveaxis(light, -1, 0), np.float32))
    return transfer.encode(planes.clamp(0, 1)).clamp(0, 1)


def _write_maps(view: _View, take: Take, job: Job) -> None:
    z = first_hits(take, job.placement, view.number)
    maps = {"disparity": job.placement.disparity(z)}
    if not in_disparities(job.display):
        maps["depth"] = 1e3 * job.placement.gain * z
    for name, values in maps.items():
        (view.folder / name).mkdir(exist_ok=True)
        file = view.folder / name / f"{name}_{view.name}.npy"
        with whole_file(file, force=True) as temporary:
            np.save(temporary, values.astype(np.float32), allow_pickle=False)


def _made_with() -> dict[str, Any]:
    mi = mitsuba()

    known = provenance(torch.device("cpu"))
    ours = {name: known[name] for name in ("layerfield", "processor")}
    return {**ours, "mitsuba": mi.__version__, "variant": mi.variant()}
