"""Charts that pages draw with numbers alone: views, layers, histories, scales of colour."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from torch import Tensor

from layerfield.metrics import EXACT, decibels
from layerfield.report.plots import GRID, INK, SMALL, TEXT, Level, Line, Panel, blank, chart, tidy
from layerfield.report.rendering import ERROR_COLOURS

HIGHEST = decibels(EXACT)  # dB that exact views are drawn with
# Colours that stay apart for colour-blind eyes (Okabe and Ito), dark enough for lines on white.
PALETTE = ("#0072b2", "#d55e00", "#008f68", "#a8478a", "#8a6d00", "#3a8fc4", "#555a63", "#7a3b00")
REFERENCE = "#191c21"

_WIDTH = 4.8  # inches of a chart that stands alone; narrow, so that it is legible on a phone
_MOST_NUMBERS = 13  # columns of a map that have room for numbers
_VALUES = "viridis"

By_view = Sequence[float | None]


def finite_span(values: Sequence[By_view]) -> tuple[float, float]:
    """Return the lowest and highest of figures in dB, exact ones as high as they are drawn."""
    drawn = [value for each in values for value in _drawn(each)]
    return min(drawn), max(drawn)


def _drawn(by_view: By_view) -> list[float]:
    return [HIGHEST if value is None else min(value, HIGHEST) for value in by_view]


def view_figure(
    by_view: By_view, grid: tuple[int, int] | None, span: tuple[float, float] | None = None
) -> Figure:
    """Draw the PSNR of every view: a map on a grid, a curve for one row or a list.

    Args:
        by_view: dB, row by row from the top left; None where a view is exact.
        grid: rows and columns of the viewpoints; None if they are a list.
        span: lowest and highest value of the scale; those of these views if not given.
    """
    low, high = span or finite_span([by_view])
    if grid is None or min(grid) == 1 or grid[0] * grid[1] != len(by_view):
        return _view_curve(by_view, grid, (low, high))
    return _view_map(by_view, grid, (low, high))


def _view_curve(
    by_view: By_view, grid: tuple[int, int] | None, span: tuple[float, float]
) -> Figure:
    names = {(True, False): "column of the view", (False, True): "row of the view"}
    along = names.get((grid[0] == 1, grid[1] == 1) if grid else (False, False), "view")
    style = "-" if grid else "none"  # those of a list need not be neighbours
    line = Line("", range(len(by_view)), _drawn(by_view), PALETTE[0], style, marker="o")
    figure = chart("", [Panel("", along, "PSNR, dB", [line])], size=(_WIDTH, 2.8))
    axes, room = figure.axes[0], max(0.1, 0.08 * (span[1] - span[0]))
    axes.set_ylim(span[0] - room, span[1] + room)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=12))
    return figure


def _view_map(by_view: By_view, grid: tuple[int, int], span: tuple[float, float]) -> Figure:
    rows, columns = grid
    cell = min(0.52, 4.6 / columns)
    figure = blank(max(cell * columns, 1.8) + 1.5, max(cell * rows, 1.6) + 0.7)
    axes = figure.subplots()
    values = np.array(_drawn(by_view)).reshape(grid)
    image = axes.imshow(
        values, cmap=_VALUES, vmin=span[0], vmax=max(span[1], span[0] + 0.01),
        interpolation="none",
    )  # fmt: skip
    if columns <= _MOST_NUMBERS:
        _write_numbers(axes, by_view, image.to_rgba(values))
    axes.set_xlabel("column of the view", fontsize=TEXT)
    axes.set_ylabel("row of the view", fontsize=TEXT)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    axes.tick_params(labelsize=SMALL)
    scale = figure.colorbar(image, ax=axes, pad=0.03, aspect=16)
    scale.set_label("PSNR, dB", fontsize=TEXT)
    scale.ax.tick_params(labelsize=SMALL)
    return figure


def _write_numbers(axes: Axes, by_view: By_view, colours: Float[np.ndarray, "y x 4"]) -> None:
    """Write figures into the cells of a map, in black or white, whichever stands out."""
    size = 8 if colours.shape[1] <= 9 else 6
    brightness = colours[..., :3] @ (0.2126, 0.7152, 0.0722)
    for value, ((y, x), bright) in zip(by_view, np.ndenumerate(brightness), strict=True):
        text = "exact" if value is None else f"{value:.1f}"
        ink = "white" if bright < 0.45 else "black"
        axes.text(x, y, text, ha="center", va="center", fontsize=size, color=ink)


def history_chart(
    iterations: Sequence[int], errors: Sequence[float], levels: Sequence[Level], y_label: str
) -> Figure:
    """Draw PSNR against iterations.

    Args:
        iterations: their numbers.
        errors: mean square errors after them.
        levels: lines to compare with.
        y_label: of the axis, with its unit.
    """
    values = [decibels(max(error, EXACT)) for error in errors]
    line = Line("this run", iterations, values, PALETTE[0], marker="o" if len(values) < 40 else "")
    figure = chart("", [Panel("", "iteration", y_label, [line], levels)], size=(_WIDTH, 3.1))
    figure.axes[0].xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure


def histogram_chart(layers: Float[Tensor, "layer n"]) -> Figure:
    """Draw how often values occur in layers.

    Args:
        layers: values from 0 to 1 of every layer, front to back.
    """
    figure = blank(_WIDTH, 3.1)
    axes = figure.subplots()
    for k, values in enumerate(layers):
        counts = torch.histc(values.float().cpu(), bins=64, min=0, max=1).double()
        shares, edges = 100 * counts / values.numel(), np.linspace(0, 1, 65)
        axes.stairs(
            shares.clamp(min=1e-4).numpy(), edges, baseline=1e-4, lw=1.5,
            color=PALETTE[k % len(PALETTE)], label=layer_name(k),
        )  # fmt: skip
    axes.set_yscale("log")
    axes.set(xlim=(0, 1), ylim=(0.005, 150))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_xlabel("value of the pixel in its file, 0 to 1", fontsize=TEXT)
    axes.set_ylabel("share of the pixels, %", fontsize=TEXT)
    axes.legend(frameon=False, fontsize=SMALL, ncols=2)
    tidy(axes)
    return figure


def layer_name(k: int) -> str:
    """Return the name of a layer, counted from the one nearest to the viewer."""
    return f"layer {k} (nearest)" if k == 0 else f"layer {k}"


def means_chart(means: Sequence[float]) -> Figure:
    """Draw the mean light of every layer, from 0 to 1, with its part of the sum."""
    figure = blank(_WIDTH, 0.9 + 0.4 * len(means))
    axes = figure.subplots()
    names = [layer_name(k) for k in range(len(means))]
    axes.barh(names, means, color=PALETTE[0], height=0.6)
    for y, (mean, share) in enumerate(zip(means, shares(means), strict=True)):
        axes.annotate(
            f"{mean:.3f} ({100 * share:.0f} % of the sum)", (mean, y), xytext=(5, 0),
            textcoords="offset points", va="center", fontsize=SMALL, color=INK,
        )  # fmt: skip
    axes.set_xlim(0, max(1.85 * max(means), 0.01))
    axes.invert_yaxis()
    axes.set_xlabel("mean light of the layer, 0 to 1", fontsize=TEXT)
    tidy(axes)
    axes.grid(visible=False, axis="y")
    return figure


def shares(means: Sequence[float]) -> list[float]:
    """Return the parts of their sum; nothing of nothing.

    >>> shares([1.0, 3.0]), shares([0.0])
    ([0.25, 0.75], [0.0])
    """
    total = sum(means)
    return [mean / total if total else 0.0 for mean in means]


def scale_chart(largest: float, label: str) -> Figure:
    """Draw the scale of colours of error maps, from 0 to the largest."""
    figure = blank(_WIDTH, 0.75)
    axes = figure.subplots()
    steps = np.linspace(0, largest, 256)[None]
    axes.imshow(
        colormaps[ERROR_COLOURS](Normalize(0, largest)(steps)), extent=(0, largest, 0, 1),
        aspect="auto", interpolation="none",
    )  # fmt: skip
    axes.set_yticks([])
    axes.tick_params(labelsize=SMALL)
    axes.set_xlabel(label, fontsize=TEXT)
    axes.spines[:].set_color(GRID)
    return figure


def slice_chart(slices: Sequence[tuple[str, Float[Tensor, "c column x"]]]) -> Figure:
    """Draw epipolar slices, one below the other.

    Args:
        slices: name, and the same line of pixels in every view of a row.
    """
    figure = blank(1.1 * _WIDTH, 0.7 + 1.25 * len(slices))
    all_axes = figure.subplots(len(slices), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (name, pixels) in zip(all_axes, slices, strict=True):
        codes = (pixels.detach().cpu().float().clamp(0, 1) * 255).round().byte()
        shown = np.moveaxis(codes.expand(3, -1, -1).numpy(), 0, -1)
        axes.imshow(shown, aspect="auto", interpolation="none")
        axes.set_title(name, fontsize=TEXT, color=INK, loc="left")
        axes.set_ylabel("column of\nthe view", fontsize=SMALL)
        axes.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=5))
        axes.tick_params(labelsize=SMALL)
    all_axes[-1].set_xlabel("x in the view, px", fontsize=TEXT)
    return figure
