"""The figure of a scaling run: time against pixels, views and layers."""

from collections.abc import Iterator, Sequence

from matplotlib.ticker import FixedLocator

from layerfield.bench.figures import line_of
from layerfield.bench.scaling import ScaleRow
from layerfield.report.charts import REFERENCE
from layerfield.report.evaluation_figures import plain_numbers
from layerfield.report.page import Chart
from layerfield.report.plots import Line, Panel, chart
from layerfield.report.rendering import label

_UNITS = {
    "pixels": "megapixels of a view (5x5 views, 3 layers)",
    "views": "views (within the same angle, 3 layers)",
    "layers": "layers (within the same depth, 5x5 views)",
}
_SIZE = (11.0, 5.0)  # inches


def growth_chart(rows: Sequence[ScaleRow], made_on: str) -> Chart:
    """Return seconds against pixels, views and layers, with lines in proportion.

    Args:
        rows: of a scaling run; those that were left out are not drawn.
        made_on: processor and threads.
    """
    timed = [row for row in rows if row.seconds is not None]
    panels = [
        Panel(
            axis,
            _UNITS[axis],
            f"seconds a picture; {label(made_on)}",
            [*_lines(timed, axis), _in_proportion(timed, axis)],
            log_x=True,
        )
        for axis in dict.fromkeys(row.axis for row in timed)
    ]
    figure = chart("", panels, log_y=True, size=_SIZE)
    for axes, panel in zip(figure.axes, panels, strict=True):
        plain_numbers(axes.xaxis, *axes.get_xlim())
        if panel.title != "pixels":
            axes.xaxis.set_major_locator(FixedLocator(_amounts(timed, panel.title)))
        plain_numbers(axes.yaxis, *axes.get_ylim())
    return Chart(
        "scaling",
        figure,
        "Time of a fixed number of iterations. The dotted line grows in proportion: methods that "
        "are no steeper at most double their time when the amount doubles.",
        "Seconds against " + ", ".join(panel.x_label for panel in panels),
    )


def _lines(rows: Sequence[ScaleRow], axis: str) -> Iterator[Line]:
    names = dict.fromkeys((row.method, row.link) for row in rows)
    for number, (method, link) in enumerate(names):
        own = [r for r in rows if (r.axis, r.method, r.link) == (axis, method, link)]
        if own:
            yield line_of(number, f"{method}, {link}", *_points(own))


def _in_proportion(rows: Sequence[ScaleRow], axis: str) -> Line:
    """A line of slope one from the first point of the first curve."""
    own = [row for row in rows if row.axis == axis]
    x, y = _points([r for r in own if (r.method, r.link) == (own[0].method, own[0].link)])
    return Line("in proportion", [x[0], x[-1]], [y[0], y[0] * x[-1] / x[0]], REFERENCE, ":")


def _amounts(rows: Sequence[ScaleRow], axis: str) -> list[int]:
    return sorted({row.amount for row in rows if row.axis == axis})


def _points(rows: Sequence[ScaleRow]) -> tuple[list[float], list[float]]:
    found = [(row, row.seconds) for row in rows if row.seconds is not None]
    unit = 1e-6 if rows[0].axis == "pixels" else 1.0
    return [unit * row.amount for row, _ in found], [seconds.median for _, seconds in found]
