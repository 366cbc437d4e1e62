"""The figures of a benchmark: what every method reaches in what time."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes

from layerfield.bench.rows import BenchRow
from layerfield.bench.standing import Standing, standings
from layerfield.report.charts import PALETTE, REFERENCE
from layerfield.report.evaluation_figures import plain_numbers
from layerfield.report.page import Chart
from layerfield.report.plots import MUTED, SMALL, Level, Line, Panel, chart
from layerfield.report.rendering import label

MARKERS = "osD^vP*X"
_SIZE = (8.4, 6.0)  # inches
_DEEPEST = 4.0  # dB below the reference that are shown
_LEAST = 0.1  # %; less is drawn there, an axis has no 0
_TENTH = 100 * (10**0.01 - 1)  # % of excess that are 0.1 dB

Value = Callable[[Standing], float]


@dataclass(frozen=True)
class Measure:
    """What a chart shows of every standing.

    Args:
        name: of the chart's files.
        value: the figure, in the unit of the axis.
        title: of the axis, with its unit; `{kind}` is the kind of the reference.
        levels: to compare with, named with the same `{kind}`.
        log: whether the axis is logarithmic.
        caption: what to read from it.
    """

    name: str
    value: Value
    title: str
    levels: Sequence[tuple[str, float]]
    log: bool
    caption: str


_MEASURES = (
    Measure(
        "frontier",
        lambda found: -found.below,
        "mean PSNR less that of the {kind}, dB",
        [("reference: the {kind}", 0.0)],
        log=False,
        caption=f"Upper left is better. What is more than {_DEEPEST:g} dB below is not shown.",
    ),
    Measure(
        "excess",
        lambda found: max(100 * found.excess_median, _LEAST),
        "median excess error over the {kind}, %",
        [("0.1 dB over the {kind}", _TENTH)],
        log=True,
        caption="Lower left is better. Errors are those of 8-bit panels, each pixel rounded by "
        f"itself, which no method can undo; less than {_LEAST:g} % is drawn there.",
    ),
)


def frontier_charts(rows: Sequence[BenchRow], made_on: str, cap: float) -> Iterator[Chart]:
    """Return charts of one display: nearness to the reference against time.

    Args:
        rows: of the display.
        made_on: processor and threads.
        cap: of a run, seconds.
    """
    found = standings(rows)
    kinds = " or ".join(sorted({row.yardstick.kind for row in rows}))
    count = len({row.field for row in rows})
    fields = "one light field" if count == 1 else f"the mean of {count} light fields"
    for measure in _MEASURES:
        panel = Panel(
            f"{label(rows[0].display)}: 8-bit views to 8-bit panels, {fields}",
            f"seconds a picture; {label(made_on)}",
            measure.title.format(kind=kinds),
            [*_lines(found, measure.value), *_capped(found, measure.value, cap)],
            [Level(text.format(kind=kinds), y, REFERENCE) for text, y in measure.levels],
            log_x=True,
        )
        figure = chart("", [panel], log_y=measure.log, size=_SIZE)
        _finish(figure.axes[0], found, measure)
        yield Chart(
            f"{measure.name}-{file_name(rows[0].display)}",
            figure,
            f"{measure.caption} Lines join one method at several numbers of iterations, which "
            "stand beside the points.",
            f"{panel.y_label} against {panel.x_label}",
        )


def file_name(display: str) -> str:
    """Return a display's name as a part of a file name.

    >>> file_name("my display/2")
    'my-display-2'
    """
    return re.sub(r"[^\w.-]+", "-", display)


def line_of(number: int, name: str, x: Sequence[float], y: Sequence[float]) -> Line:
    """Return the curve of the method that stands in this place of the legend."""
    style = "-" if number < len(PALETTE) else "--"
    marker = MARKERS[number % len(MARKERS)]
    return Line(label(name), x, y, PALETTE[number % len(PALETTE)], style, marker=marker)


def _lines(found: Sequence[Standing], value: Value) -> Iterator[Line]:
    for number, method in enumerate(dict.fromkeys(each.method for each in found)):
        own = sorted((s for s in found if s.method == method), key=lambda s: s.iterations)
        yield line_of(number, method, [s.seconds for s in own], [value(s) for s in own])


def _capped(found: Sequence[Standing], value: Value, cap: float) -> Iterator[Line]:
    """A cross over every point behind which the cap left out more iterations."""
    over = [each for each in found if each.capped]
    if over:
        text = f"over the cap of {cap:g} s: not run for longer"
        x, y = [each.seconds for each in over], [value(each) for each in over]
        yield Line(text, x, y, REFERENCE, "none", marker="x")


def _finish(axes: Axes, found: Sequence[Standing], measure: Measure) -> None:
    """Write iterations beside points, plain numbers on logarithmic axes, and cut what is far."""
    for line in axes.lines:
        line.set_markersize(11 if line.get_marker() == "x" else 5)
    for each in found:
        if each.iterations:
            axes.annotate(
                f"{each.iterations}", (each.seconds, measure.value(each)), xytext=(4, -10),
                textcoords="offset points", fontsize=SMALL - 2, color=MUTED, annotation_clip=True,
            )  # fmt: skip
    axes.margins(0.06)
    plain_numbers(axes.xaxis, *axes.get_xlim())
    if measure.log:
        plain_numbers(axes.yaxis, *axes.get_ylim())
    else:
        low, _ = axes.get_ylim()
        axes.set_ylim(max(low, -_DEEPEST), 0.06 * min(_DEEPEST, -low))
