"""How time grows with pixels, views and layers, on procedural scenes.

pixels   256x256 to 3840x2160 in doublings; 5x5 views, 3 layers
views    3x3 to 17x17 within the same angle, so that layers keep their margin of 8 pixels; 3 layers
layers   2 to 6 within the same depth; 5x5 views

All shifts are whole pixels. What is timed is a number of iterations, not a quality.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import torch
from jaxtyping import UInt8
from torch import Tensor

from layerfield.bench.frontier import unserved
from layerfield.bench.road import EightBitViews, Panels, views_to_panels
from layerfield.bench.rows import NOT_OURS, Effort
from layerfield.bench.timing import Seconds, timed, timed_by_turns
from layerfield.display import Display
from layerfield.display_spec import DisparitySpec
from layerfield.geometry import grid_points
from layerfield.scenes import render, scenes_for
from layerfield.synthesizer import spelled

PIXELS = (
    (256, 256), (256, 512), (512, 512), (512, 1024), (1024, 1024), (1024, 2048), (2048, 2048),
    (2160, 3840),
)  # fmt: skip
GRIDS = ((3, 3), (3, 5), (5, 5), (5, 9), (9, 9), (9, 17), (17, 17))
STACKS = (
    (3.0, -3.0), (3.0, 0.0, -3.0), (3.0, 1.0, -1.0, -3.0), (3.0, 1.0, 0.0, -1.0, -3.0),
    (3.0, 2.0, 1.0, -1.0, -2.0, -3.0),
)  # fmt: skip
_SIZE, _REACH = (512, 512), 8.0  # of views and stacks: pixels, and the outermost views' shift
_PATCH = 128  # pixels of the scene that is mirrored until views are full
_OF_VIEWS, _OF_LAYERS = 3, 24  # float arrays of that size that a run may hold at a time
_MEMORY = Path("/proc/meminfo")  # of Linux


@dataclass(frozen=True)
class Case:
    """One size of the problem.

    Args:
        axis: what grows: pixels, views or layers.
        size: height and width of the views.
        grid: rows and columns of the viewpoints.
        disparity: of the layers, pixels for a slope of one, front to back.
        reach: slope of the outermost viewpoints; as many as there are steps if not given.
    """

    axis: str
    size: tuple[int, int] = _SIZE
    grid: tuple[int, int] = (5, 5)
    disparity: tuple[float, ...] = (1.0, 0.0, -1.0)
    reach: float | None = None

    @property
    def amount(self) -> int:
        """Pixels of a view, views or layers: what grows."""
        amounts = {"views": math.prod(self.grid), "layers": len(self.disparity)}
        return amounts.get(self.axis, math.prod(self.size))

    @property
    def megabytes(self) -> float:
        """About as much memory as a run may take, colours included."""
        views, layers = _OF_VIEWS * math.prod(self.grid), _OF_LAYERS * len(self.disparity)
        return (views + layers) * 3 * math.prod(self.size) * 4 / 2**20

    def display(self, link: str) -> Display:
        """Return a display of that link."""
        rows, columns = self.grid
        step = (1.0, 1.0)
        if self.reach is not None:
            step = (2 * self.reach / (columns - 1), 2 * self.reach / (rows - 1))
        return Display(
            DisparitySpec(
                name=f"{len(self.disparity)} layers, {rows}x{columns} views",
                link=link,  # pyright: ignore[reportArgumentType]
                disparity=self.disparity,
                viewpoints=grid_points(self.grid, step),
            )
        )

    def views(self, device: torch.device) -> EightBitViews:
        """Return a procedural scene, mirrored until the views are full."""
        geometry = self.display("additive").geometry
        patch = render(scenes_for(geometry, 1, size=(_PATCH, _PATCH)), geometry.slopes)[0]
        codes = (patch * 255).round().to(device, torch.uint8)
        return EightBitViews(_mirrored(codes, self.size), self.grid, self.axis)


def cases() -> Iterator[Case]:
    """Return all sizes, those of a series from small to large."""
    yield from (Case("pixels", size=size) for size in PIXELS)
    yield from (Case("views", grid=grid, reach=_REACH) for grid in GRIDS)
    yield from (Case("layers", disparity=stack) for stack in STACKS)


def _mirrored(codes: UInt8[Tensor, "view c y x"], size: tuple[int, int]) -> Tensor:
    """Mirror pictures at their lower and right edges until they have a size."""
    for axis, length in zip((-2, -1), size, strict=True):
        there_and_back = torch.cat([codes, codes.flip(axis)], axis)
        times = -(-length // there_and_back.shape[axis])
        codes = torch.cat([there_and_back] * times, axis).narrow(axis, 0, length)
    return codes.contiguous()


@dataclass(frozen=True)
class ScaleRow:
    """A method on one size.

    Args:
        axis: what grows in this series.
        amount: of it: pixels of a view, views or layers.
        size: height and width of the views.
        grid: rows and columns of the viewpoints.
        layers: their number.
        link: of the display.
        method: and iterations, as `evaluate` takes them.
        seconds: from 8-bit views to 8-bit panels; None if it was not run.
        per_doubling: by how much time grows from the size before, for twice the amount; both run
            by turns.
        left_out: why it was not run.
    """

    axis: str
    amount: int
    size: tuple[int, int]
    grid: tuple[int, int]
    layers: int
    link: str
    method: str
    seconds: Seconds | None = None
    per_doubling: float | None = None
    left_out: str | None = None

    @property
    def series(self) -> tuple[str, str, str]:
        """What rows share that differ in their amount alone."""
        return self.axis, self.link, self.method

    def as_record(self) -> dict[str, Any]:
        """Return the row as plain data for JSON."""
        return asdict(self)

    @classmethod
    def of_record(cls, record: dict[str, Any]) -> "ScaleRow":
        """Return the row that a record was made from.

        Raises:
            ValueError: it is none.
        """
        try:
            own = dict(record, size=tuple(record["size"]), grid=tuple(record["grid"]))
            own["seconds"] = own["seconds"] and Seconds(**own["seconds"])
            return cls(**own)
        except (KeyError, TypeError):
            raise ValueError(NOT_OURS) from None


@dataclass(frozen=True)
class Growth:
    """What is run on every size.

    Args:
        links: of the displays.
        methods: names and iterations.
        effort: repeats, and the cap behind which a series ends.
        device: that all is done on.
        sizes: all `cases` if not given.
    """

    links: Sequence[str]
    methods: Sequence[tuple[str, int]]
    effort: Effort
    device: torch.device
    sizes: Sequence[Case] = field(default_factory=lambda: tuple(cases()))


def run_growth(
    growth: Growth,
    *,
    known: Sequence[ScaleRow] = (),
    keep: Callable[[Sequence[ScaleRow]], None] = lambda _: None,
    tick: Callable[[str], None] = lambda _: None,
) -> list[ScaleRow]:
    """Time methods on every size that fits and is not known yet.

    Args:
        growth: what to run.
        known: rows of an earlier run, which stay as they are; what was left out is tried again.
        keep: called with all rows after each.
        tick: called with a word on what is being done.
    """
    rows = [row for row in known if row.seconds is not None]
    done = {(row.series, row.amount) for row in rows}
    views_of = lru_cache(maxsize=2)(lambda case: case.views(growth.device))
    for case in growth.sizes:
        large = _too_large(case, growth.device)
        for link, method in product(growth.links, growth.methods):
            blank = _blank(case, link, spelled(*method))
            if (blank.series, case.amount) in done:
                continue
            tick(f"{case.axis} {case.amount}, {blank.link}: {blank.method}")
            if large:
                rows.append(replace(blank, left_out=large))
            else:
                series = [row for row in rows if row.series == blank.series]
                rows.append(_scaled(blank, case, views_of, method, series, growth))
            keep(rows)
    return rows


def _blank(case: Case, link: str, method: str) -> ScaleRow:
    layers = len(case.disparity)
    return ScaleRow(case.axis, case.amount, case.size, case.grid, layers, link, method)


def _scaled(
    blank: ScaleRow,
    case: Case,
    views_of: Callable[[Case], EightBitViews],
    method: tuple[str, int],
    series: Sequence[ScaleRow],
    growth: Growth,
) -> ScaleRow:
    """Return the row of a size, timed by turns with the one before if there is one."""
    known, effort = {row.amount: row.seconds for row in series if row.seconds}, growth.effort
    smaller = [s for s in growth.sizes if s.axis == case.axis and s.amount < case.amount]
    before = next((size for size in reversed(smaller) if size.amount in known), None)
    if before is not None and known[before.amount].median > effort.cap:
        return replace(blank, left_out=f"the size before took over {effort.cap:g} s")
    why = unserved(method[0], case.display(blank.link))
    if why is not None:
        return replace(blank, left_out=why)

    def road(size: Case) -> Callable[[], Panels]:
        views, display = views_of(size), size.display(blank.link)
        return lambda: views_to_panels(views, display, *method)

    if before is None:
        seconds, _ = timed(road(case), growth.device, repeats=effort.repeats, cap=effort.cap)
        return replace(blank, seconds=seconds)
    runs = road(case), road(before)
    seconds, times = timed_by_turns(*runs, growth.device, repeats=effort.repeats, cap=effort.cap)
    return replace(blank, seconds=seconds, per_doubling=_per_doubling(times, case, before))


def _per_doubling(times: float, case: Case, before: Case) -> float:
    """By how much time grows for twice the amount: 2 if in proportion, less if slower."""
    return 2 ** (math.log(times) / math.log(case.amount / before.amount))


def _too_large(case: Case, device: torch.device) -> str | None:
    free = _free_megabytes(device)
    if free is None or case.megabytes <= free:
        return None
    return f"it may need {case.megabytes / 1024:.1f} GB, {free / 1024:.1f} GB are free"


def _free_megabytes(device: torch.device) -> float | None:
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0] / 2**20
    if not _MEMORY.is_file():
        return None
    lines = _MEMORY.read_text("utf-8").splitlines()
    return next((int(s.split()[1]) / 1024 for s in lines if s.startswith("MemAvailable")), None)


def growth_lines(rows: Sequence[ScaleRow]) -> list[list[str]]:
    """Return a table of text, a heading first."""
    heading = ["grows", "views", "layers", "link", "method", "s", "per doubling"]
    return [heading] + [
        [
            row.axis,
            f"{row.grid[0]}x{row.grid[1]} of {row.size[1]}x{row.size[0]}",
            f"{row.layers}",
            row.link,
            row.method,
            row.left_out or "" if row.seconds is None else f"{row.seconds.median:.3g}",
            "" if row.per_doubling is None else f"x {row.per_doubling:.2f}",
        ]
        for row in rows
    ]
