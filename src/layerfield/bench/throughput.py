"""Pictures a second at a quality, beside the floor that memory sets.

The fewest bytes that a picture must move are its 8-bit views, read once, and its 8-bit layers,
written once. Divided by what a copy within the device's memory reaches, that is the floor.
"""

import math
import statistics
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import cycle, islice
from typing import Any

import torch

from layerfield.bench.recorded_road import Pipeline
from layerfield.bench.road import EightBitViews, Panels, views_to_panels
from layerfield.bench.timing import Seconds, once
from layerfield.display import Display
from layerfield.display_constants import constants_of
from layerfield.display_spec import DisparitySpec
from layerfield.metrics import excess, mean_square_error
from layerfield.panels import dequantise
from layerfield.reference import Reference, reference
from layerfield.scenes import procedural_light_field
from layerfield.synthesizer import pose, spelled
from layerfield.transfer import NONE, Srgb, Transfer, named

_COPY_BYTES = 2**28  # of the array that is copied to measure bandwidth
_COPIES = 10
Road = Callable[[EightBitViews], Panels]


@dataclass(frozen=True)
class Stream:
    """Pictures that follow one another.

    Args:
        size: height and width of a view.
        pictures: different ones, which take turns.
        length: of a run, pictures.
        repeats: runs, of which the median counts.
        judged: how many of them quality is measured on; their references take minutes each.
        quality: the most excess error of the 8-bit layers, on the worst of those.
        budgets: numbers of iterations to try, increasing; the first that reaches it is timed.
        at_once: pictures under way together on a GPU, see `Pipeline`.
    """

    size: tuple[int, int] = (1080, 1920)
    pictures: int = 4
    judged: int = 1
    length: int = 30
    repeats: int = 5
    quality: float = 0.05
    budgets: Sequence[int] = (1, 2, 3, 4, 5, 6, 8, 10, 15, 20)
    at_once: int = 2


@dataclass(frozen=True)
class StreamRow:
    """What a method makes of a stream on a display.

    Args:
        link: of the display.
        transfer: what values stand for; "none": they are taken as light.
        method: title.
        iterations: the fewest that reach the quality; the most that were tried if none do.
        excess: of the 8-bit layers over the reference, on the worst of the judged pictures.
        reached: whether that is the quality asked for.
        reference: kind of what errors are compared with.
        seconds: of a picture of a stream, medians over runs.
        latency: of a picture alone: the device is waited for after each.
        floor: seconds; see the top of this module.
        peak_mb: of the device's memory; None on a CPU.
    """

    link: str
    transfer: str
    method: str
    iterations: int
    excess: float
    reached: bool
    reference: str
    seconds: Seconds
    latency: Seconds
    floor: float
    peak_mb: float | None

    @property
    def pictures_a_second(self) -> float:
        """Of the median run."""
        return 1 / self.seconds.median

    def as_record(self) -> dict[str, Any]:
        """Return the row as plain data for JSON."""
        rates = {"pictures_a_second": self.pictures_a_second, "floor_a_second": 1 / self.floor}
        return asdict(self) | rates


def displays() -> list[Display]:
    """Return 5x5 views on 3 layers: sum and product, values as they are and linear light."""
    return [_display(link, t) for link in ("additive", "multiplicative") for t in (NONE, Srgb())]


def _display(link: str, transfer: Transfer) -> Display:
    return Display(
        DisparitySpec(
            name=f"{link}, {named(transfer)}",
            link=link,  # pyright: ignore[reportArgumentType]
            disparity=(1.0, 0.0, -1.0),
            views=(5, 5),
            transfer=transfer,
        )
    )


def pictures(stream: Stream, device: torch.device) -> list[EightBitViews]:
    """Return different procedural scenes, on the device."""
    made = []
    for seed in range(stream.pictures):
        field = procedural_light_field(size=stream.size, seed=seed, device=device)
        made.append(EightBitViews.of(field, device))
    return made


def floor_seconds(views: EightBitViews, display: Display, bandwidth: float) -> float:
    """Return the time of the fewest bytes that a picture must move, at a bandwidth in bytes/s."""
    layer = math.prod(n + 2 * m for n, m in zip(views.size, display.margin, strict=True))
    layers = display.layer_count * display.subframes * views.codes.shape[1] * layer
    return (views.codes.numel() + layers) / bandwidth


def copy_bandwidth(device: torch.device, size: int = _COPY_BYTES) -> float:
    """Return the bytes a second that a copy within the device's memory reads and writes."""
    source = torch.ones(size, dtype=torch.uint8, device=device)
    target = torch.empty_like(source)

    def copies() -> None:  # in one go: to wait for each would take as long as a copy
        for _ in range(_COPIES):
            target.copy_(source)

    copies()
    seconds = [once(copies, device)[0] for _ in range(_COPIES)]
    return 2 * size * _COPIES / statistics.median(seconds)


def references(views: Sequence[EightBitViews], display: Display) -> list[Reference]:
    """Return the references of pictures."""
    return [reference(pose(each.light_field(), display)) for each in views]


def run_stream(
    views: Sequence[EightBitViews],
    display: Display,
    best: Sequence[Reference],
    method: tuple[str, Sequence[int]],
    stream: Stream,
    bandwidth: float,
) -> StreamRow:
    """Find the iterations that reach the quality, and time them.

    Args:
        views: pictures, on the device.
        display: that shows them.
        best: references of the first pictures, those that are judged.
        method: name, and numbers of iterations to try.
        stream: how.
        bandwidth: of the device, bytes/s.
    """
    (name, tried), device = method, views[0].codes.device

    def road(count: int) -> Road:
        return partial(views_to_panels, display=display, method=name, iterations=count)

    def error_of(one: Road) -> float:
        judged = zip(views, best, strict=False)  # the first ones
        return max(_excess(one(each), each, display, known) for each, known in judged)

    reach = (count for count in tried if error_of(road(count)) <= stream.quality)
    iterations = next(reach, tried[-1])

    constants_of.cache_clear()
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats(device)
        one = Pipeline(views[0], display, name, iterations, stream.at_once)
        several = one.run
    else:
        one = road(iterations)
        several = partial(map, one)

    def all_in_turn() -> None:
        deque(several(islice(cycle(views), stream.length)), maxlen=0)

    all_in_turn()
    peak = torch.cuda.max_memory_allocated(device) / 2**20 if device.type == "cuda" else None
    error = error_of(one)  # of what is timed
    runs = [once(all_in_turn, device)[0] / stream.length for _ in range(stream.repeats)]
    single = [once(lambda v=v: one(v), device)[0] for v in islice(cycle(views), stream.length)]
    return StreamRow(
        display.link.name,
        named(display.transfer),
        name,
        iterations,
        error,
        error <= stream.quality,
        best[0].kind,
        Seconds.of(runs),
        Seconds.of(single),
        floor_seconds(views[0], display, bandwidth),
        peak,
    )


def _excess(panels: Panels, views: EightBitViews, display: Display, best: Reference) -> float:
    shown = display(dequantise(panels.codes, display.transfer))
    light = display.transfer.decode(views.light_field().views)
    return excess(mean_square_error(shown, light), best.mean_square_error)


def stream_lines(rows: Sequence[StreamRow]) -> list[list[str]]:
    """Return a table of text, a heading first."""
    heading = ["display", "transfer", "method", "excess", "pictures/s", "ms", "alone ms", "floor/s"]
    return [heading] + [
        [
            row.link,
            row.transfer,
            spelled(row.method, row.iterations),
            f"{row.excess:.1%}" + ("" if row.reached else " (not reached)"),
            f"{row.pictures_a_second:.1f}",
            f"{1e3 * row.seconds.median:.2f}",
            f"{1e3 * row.latency.median:.2f}",
            f"{1 / row.floor:.0f}",
        ]
        for row in rows
    ]
