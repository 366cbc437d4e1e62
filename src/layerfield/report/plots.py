"""Charts and sheets of pictures, drawn with matplotlib's objects; nothing is kept between them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from torch import Tensor

INK, MUTED, GRID = "#191c21", "#5f646e", "#dddfe3"
TITLE, TEXT, SMALL = 12, 10, 9  # points
_DPI = 110
_SLIMMEST = 2.0  # pictures higher than so many times their width are drawn less wide
_LETTERS, _LINE = 13, 0.17  # small ones in an inch, and the height of their line in inches
_MOST_COLUMNS = 4  # of a legend


@dataclass(frozen=True)
class Line:
    """A curve, with a colour that means the same in every figure.

    Args:
        label: in the legend; "" leaves it out.
        x: positions.
        y: values.
        colour: of the line.
        style: `-`, `--`, `:` or `-.`.
        width: points.
        marker: of its points; one point alone has one always.
    """

    label: str
    x: Sequence[float]
    y: Sequence[float]
    colour: str
    style: str = "-"
    width: float = 1.8
    marker: str = ""


@dataclass(frozen=True)
class Level:
    """A horizontal line, named at its right end or in the legend."""

    label: str
    y: float
    colour: str
    style: str = "--"


@dataclass(frozen=True)
class Panel:
    """One chart.

    Args:
        title: above it.
        x_label: with its unit.
        y_label: with its unit.
        lines: curves.
        levels: horizontal lines.
        log_x: logarithmic axis.
        bottom: lowest value of the y axis; as the values want it if not given.
    """

    title: str
    x_label: str
    y_label: str
    lines: Sequence[Line]
    levels: Sequence[Level] = ()
    log_x: bool = False
    bottom: float | None = None


def chart(
    title: str,
    panels: Sequence[Panel],
    *,
    log_y: bool = False,
    size: tuple[float, float] | None = None,
) -> Figure:
    """Draw panels side by side with one y axis and one legend below.

    Args:
        title: of the figure; "" leaves it out.
        panels: from left to right.
        log_y: logarithmic axis.
        size: width and height in inches; as many panels want it if not given.
    """
    figure = blank(*(size or (max(7.0, 4.6 * len(panels)), 4.9)), title)
    all_axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    handles: dict[str, Line2D] = {}
    for axes, panel in zip(all_axes, panels, strict=True):
        _draw(axes, panel)
        if log_y:
            axes.set_yscale("log")
        handles |= {str(h.get_label()): h for h in axes.lines if not _hidden(h)}
    all_axes[0].set_ylabel(panels[0].y_label, fontsize=TEXT)
    _legend_below(figure, handles)
    return figure


def _legend_below(figure: Figure, handles: Mapping[str, Any]) -> None:
    """Put a legend below, in as many columns as the figure is wide."""
    for columns in range(min(len(handles), _MOST_COLUMNS), 0, -1):
        legend = figure.legend(
            handles.values(), list(handles), loc="outside lower center", frameon=False,
            ncols=columns, fontsize=SMALL,
        )  # fmt: skip
        figure.draw_without_rendering()
        if columns == 1 or legend.get_window_extent().width <= figure.bbox.width:
            return
        legend.remove()


def _hidden(line: Line2D) -> bool:
    return str(line.get_label()).startswith("_")


def _draw(axes: Axes, panel: Panel) -> None:
    for each in panel.levels:
        axes.axhline(each.y, color=each.colour, linestyle=each.style, lw=1.4, label=each.label)
    for line in panel.lines:
        label = line.label or "_"
        marker = line.marker or ("o" if len(line.x) < 2 else "")
        axes.plot(
            line.x, line.y, color=line.colour, linestyle=line.style, lw=line.width, label=label,
            marker=marker,
        )  # fmt: skip
    if panel.log_x:
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    if panel.bottom is not None:
        axes.set_ylim(bottom=panel.bottom)
    axes.set_title(panel.title, fontsize=TEXT, color=INK)
    axes.set_xlabel(panel.x_label, fontsize=TEXT)
    tidy(axes)


def tidy(axes: Axes) -> None:
    """Give a chart its grid and small numbers, and no frame."""
    axes.tick_params(labelsize=SMALL)
    axes.grid(color=GRID, lw=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


@dataclass(frozen=True, eq=False)
class Cell:
    """A picture of a sheet.

    Args:
        pixels: values, clipped to 0..1 when drawn; or a map of one value a pixel with a range.
        heading: above it.
        caption: below it, its figures.
        span: lowest and highest value of a map, drawn in colours and with its numbers written in.
    """

    pixels: Float[Tensor, "c y x"]
    heading: str = ""
    caption: str = ""
    span: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Sheet:
    """Rows of pictures.

    Args:
        title: above all.
        rows: name, colour of the name, pictures.
        note: below all.
        width: of a picture, inches.
    """

    title: str
    rows: Sequence[tuple[str, str, Sequence[Cell]]]
    note: str = ""
    width: float = 2.3


def sheet(given: Sheet) -> Figure:
    """Draw rows of pictures with a name at the left of every row."""
    columns = max(len(cells) for _, _, cells in given.rows)
    height, width = given.rows[0][2][0].pixels.shape[-2:]
    tall = given.width * min(height / width, _SLIMMEST) + 0.45
    wide = given.width * columns + 0.5
    note = fill(given.note, int(wide * _LETTERS))
    high = max(tall, 1.5) * len(given.rows) + 0.65 + _LINE * note.count("\n")
    figure = blank(wide, high, given.title)
    all_axes = figure.subplots(len(given.rows), columns, squeeze=False)
    for row, (name, colour, cells) in zip(all_axes, given.rows, strict=True):
        for axes in row:
            axes.set_axis_off()
            axes.set(xticks=[], yticks=[])  # hidden ones cost time, too
        for axes, cell in zip(row, cells, strict=False):
            _draw_cell(axes, cell)
        row[0].text(
            -0.04, 0.5, name, transform=row[0].transAxes, rotation=90, ha="right", va="center",
            color=colour, fontsize=TEXT, fontweight="bold",
        )  # fmt: skip
    if note:
        figure.supxlabel(note, fontsize=SMALL, color=MUTED)
    return figure


def _draw_cell(axes: Axes, cell: Cell) -> None:
    array = cell.pixels.detach().cpu().float().numpy()
    if cell.span is None:
        shown = np.broadcast_to(array.clip(0, 1), (3, *array.shape[-2:]))
        axes.imshow(np.moveaxis(shown, 0, -1), interpolation="antialiased")
    else:
        low, high = cell.span
        axes.imshow(array[0], cmap="cividis", vmin=low, vmax=high, interpolation="nearest")
        for (y, x), value in np.ndenumerate(array[0]):
            ink = "white" if value < (low + high) / 2 else "black"
            axes.text(x, y, f"{value:.1f}", ha="center", va="center", fontsize=8, color=ink)
    axes.set_title(cell.heading, fontsize=SMALL, color=INK, pad=3)
    axes.text(
        0.5, -0.03, cell.caption, transform=axes.transAxes, ha="center", va="top",
        fontsize=SMALL, color=MUTED,
    )  # fmt: skip


@dataclass(frozen=True)
class Bars:
    """Parts of a whole for several methods, stacked from left to right.

    Args:
        title: above.
        x_label: with its unit.
        rows: name, parts.
    """

    title: str
    x_label: str
    rows: Sequence[tuple[str, Sequence[float]]]


def stacked_bars(title: str, panels: Sequence[Bars], parts: Sequence[str]) -> Figure:
    """Draw how wholes are shared, a bar for every method and a shade for every part."""
    shades = ["#1b3a57", "#6f9fc4", "#cfe0ee", "#f0c987", "#b9791f", "#6b3f0a"]
    figure = blank(5.2 * len(panels), 1.5 + 0.42 * len(panels[0].rows), title)
    all_axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, panel in zip(all_axes, panels, strict=True):
        names = [name for name, _ in panel.rows][::-1]
        left = np.zeros(len(names))
        for k, part in enumerate(parts):
            values = np.array([100 * row[k] for _, row in panel.rows][::-1])
            axes.barh(names, values, left=left, color=shades[k % len(shades)], label=part)
            for y, (start, value) in enumerate(zip(left, values, strict=True)):
                if value >= 7:
                    ink = "white" if k == 0 else "black"
                    axes.text(
                        start + value / 2, y, f"{value:.0f}", ha="center", va="center",
                        fontsize=SMALL, color=ink,
                    )  # fmt: skip
            left += values
        axes.set_title(panel.title, fontsize=TEXT)
        axes.set_xlabel(panel.x_label, fontsize=TEXT)
        axes.set_xlim(0, 100)
        axes.tick_params(labelsize=SMALL)
        axes.spines[["top", "right"]].set_visible(False)
    handles, labels = all_axes[0].get_legend_handles_labels()
    _legend_below(figure, dict(zip(labels, handles, strict=True)))
    return figure


@dataclass(frozen=True, eq=False)
class Map:
    """A value from 0 to 1 over two axes.

    Args:
        title: above it.
        values: `[y, x]`.
        x_range: first and last x.
        y_range: first and last y.
        marks: x of vertical lines.
    """

    title: str
    values: Float[Tensor, "y x"]
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    marks: Sequence[float]


@dataclass(frozen=True)
class Axes3:
    """What the axes of maps say: names with units, of x, y and the value, and of the marks."""

    x: str
    y: str
    value: str
    marks: str


def maps(title: str, panels: Sequence[Map], names: Axes3) -> Figure:
    """Draw maps in rows of up to three with one scale of colours, its middle as a contour."""
    columns = min(len(panels), 3)
    rows = -(-len(panels) // columns)
    figure = blank(max(4.0 * columns + 1.0, 6.5), 3.1 * rows + 1.0, title)
    all_axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).flatten()
    image = None
    for axes, panel in zip(all_axes, panels, strict=False):
        array, extent = panel.values.cpu().numpy(), (*panel.x_range, *panel.y_range)
        image = axes.imshow(
            array, cmap="cividis", vmin=0, vmax=1, extent=extent, origin="lower", aspect="auto",
            interpolation="nearest",
        )  # fmt: skip
        axes.contour(array, levels=[0.5], colors="black", linewidths=0.8, extent=extent)
        for mark in panel.marks:
            axes.axvline(mark, color="#d1142e", lw=1.6, linestyle="--")
        axes.set_title(panel.title, fontsize=TEXT, color=INK)
        axes.tick_params(labelsize=SMALL, labelbottom=True)
    for axes in all_axes[len(panels) :]:
        axes.set_axis_off()
    for axes in all_axes[: len(panels)]:
        axes.set_xlabel(names.x, fontsize=TEXT)
    for axes in all_axes[::columns]:
        axes.set_ylabel(names.y, fontsize=TEXT)
    assert image is not None  # there is at least one panel
    scale = figure.colorbar(image, ax=all_axes.tolist(), pad=0.02)
    scale.set_label(names.value, fontsize=TEXT)
    scale.ax.tick_params(labelsize=SMALL)
    figure.supxlabel(names.marks, fontsize=SMALL, color=MUTED)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, without the time of day."""
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=_DPI, metadata={"Software": None})


def blank(width: float, height: float, title: str = "") -> Figure:
    """Return a figure to draw into; width and height in inches."""
    figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
    if title:
        figure.suptitle(title, fontsize=TITLE, color=INK)
    return figure
