"""The figures of an evaluation: error against time, quality of views, shares of the light."""

from collections.abc import Iterator, Sequence

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from layerfield.report.charts import PALETTE, finite_span, layer_name, shares, view_figure
from layerfield.report.facts import RowFacts
from layerfield.report.page import Chart
from layerfield.report.plots import MUTED, SMALL, Bars, Line, Panel, chart, stacked_bars
from layerfield.report.rendering import label
from layerfield.report.result_figures import decibels_text

_QUICKEST, _NEAREST = 1e-3, 0.01  # s and %; what is below is drawn there, an axis has no 0
_MARKERS = "osD^vP*X"
_SIZE = (5.2, 4.2)  # inches


def frontier_chart(rows: Sequence[RowFacts], name: str) -> Chart:
    """Return what every method reaches in what time; lines join the same method.

    Args:
        rows: of one light field and display.
        name: of its files.
    """
    compared = all(row.excess is not None for row in rows)
    panel = Panel("", "time, s", _y_label(rows, compared), list(_lines(rows, compared)), log_x=True)
    figure = chart("", [panel], log_y=compared, size=_SIZE)
    _finish(figure, rows, compared)
    best = "lower left" if compared else "upper left"
    near = compared and any(100 * (row.excess or 0) < _NEAREST for row in rows)
    floor = f" Errors of less than {_NEAREST} % are drawn at {_NEAREST} %." if near else ""
    return Chart(
        name,
        figure,
        f"What is reached in what time; {best} is better. Lines join one method at several "
        f"numbers of iterations, which stand beside the points.{floor}",
        f"{'Excess error' if compared else 'PSNR'} against time of "
        + ", ".join(row.title for row in rows),
    )


def _y_label(rows: Sequence[RowFacts], compared: bool) -> str:
    if not compared:
        return "PSNR, dB"
    kind = rows[0].reference_kind or "reference"
    return f"excess error over the {label(kind)}, %"


def _lines(rows: Sequence[RowFacts], compared: bool) -> Iterator[Line]:
    for number, (method, runs) in enumerate(_by_method(rows).items()):
        x, y = zip(*(_point(run, compared) for run in runs), strict=True)
        colour = PALETTE[number % len(PALETTE)]
        yield Line(label(method), x, y, colour, marker=_MARKERS[number % len(_MARKERS)])


def _by_method(rows: Sequence[RowFacts]) -> dict[str, list[RowFacts]]:
    methods: dict[str, list[RowFacts]] = {}
    for row in sorted(rows, key=lambda row: row.iterations):
        methods.setdefault(row.method, []).append(row)
    return {row.method: methods[row.method] for row in rows}


def _point(row: RowFacts, compared: bool) -> tuple[float, float]:
    if compared:
        return max(row.seconds, _QUICKEST), max(100 * (row.excess or 0), _NEAREST)
    return max(row.seconds, _QUICKEST), 100.0 if row.psnr is None else row.psnr


def _finish(figure: Figure, rows: Sequence[RowFacts], compared: bool) -> None:
    """Write iterations beside points, and plain numbers on logarithmic axes."""
    (axes,) = figure.axes
    for row in rows:
        if row.iterations:
            axes.annotate(
                f"{row.iterations}", _point(row, compared), xytext=(5, 4),
                textcoords="offset points", fontsize=SMALL - 1, color=MUTED,
            )  # fmt: skip
    axes.margins(0.08)
    plain_numbers(axes.xaxis, *axes.get_xlim())
    if compared:
        _keep_apart(axes)
        plain_numbers(axes.yaxis, *axes.get_ylim())


def _keep_apart(axes: Axes) -> None:
    """Give values that are all alike an axis of some height."""
    low, high = axes.get_ylim()
    if high < 2 * low:
        axes.set_ylim(low / 1.5, high * 1.5)


def plain_numbers(axis: Axis, low: float, high: float) -> None:
    """Write plain numbers on a logarithmic axis that reaches from low to high."""
    steps = (1.0,) if high > 3000 * low else (1.0, 2.0, 5.0)
    axis.set_major_locator(LogLocator(subs=steps))
    axis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.set_minor_formatter(NullFormatter())


def view_charts(rows: Sequence[RowFacts], name: str) -> Iterator[Chart]:
    """Return the PSNR over the views of every method, on one scale of colours.

    Args:
        rows: of one light field and display; those without such figures are left out.
        name: of the files, which get a number each.
    """
    known = [row for row in rows if row.psnr_by_view]
    span = finite_span([row.psnr_by_view for row in known]) if known else None
    for number, row in enumerate(known, start=1):
        lowest, highest = decibels_text(row.psnr_view_min), decibels_text(row.psnr_view_max)
        yield Chart(
            f"{name}-{number}",
            view_figure(row.psnr_by_view, row.grid, span),
            f"{row.title}: {decibels_text(row.psnr)}, views from {lowest} to {highest}.",
            f"PSNR of every view with {row.title}, from {lowest} to {highest}",
        )


def shares_chart(rows: Sequence[RowFacts], name: str) -> Chart:
    """Return how layers share the light, a bar for every method.

    Args:
        rows: of one light field and display.
        name: of its files.
    """
    count = max(len(row.layers) for row in rows)
    bars = [(_apart(rows, n), _parts(row, count)) for n, row in enumerate(rows)]
    figure = stacked_bars(
        "",
        [Bars("", "part of the sum of the layers' mean light, %", bars)],
        [layer_name(k) for k in range(count)],
    )
    return Chart(
        name,
        figure,
        "How the layers share the light. Where layers add up, these are shares of what viewers "
        "see; where they do not, they say which layer is the brightest.",
        "Parts of the layers in the sum of their means, for " + ", ".join(r.title for r in rows),
    )


def _parts(row: RowFacts, count: int) -> list[float]:
    means = [layer.mean for layer in row.layers]
    return shares(means) + [0.0] * (count - len(means))


def _apart(rows: Sequence[RowFacts], number: int) -> str:
    """Name a row; a method that was run twice gets a number, as bars of one name are one."""
    title = rows[number].title
    earlier = sum(row.title == title for row in rows[:number])
    return label(title) + (f" ({earlier + 1})" if earlier else "")
