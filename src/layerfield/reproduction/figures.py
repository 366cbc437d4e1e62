"""The paper's figures, from what was measured."""

from collections.abc import Iterator, Mapping

import torch
from matplotlib.figure import Figure

from layerfield.display import Display
from layerfield.light_field import LightField
from layerfield.report.comparison import ERROR_GAIN, error_map
from layerfield.report.plots import (
    Bars,
    Cell,
    Level,
    Line,
    Panel,
    Sheet,
    chart,
    sheet,
    stacked_bars,
)
from layerfield.reproduction.contenders import CNN, COLOURS, COURSES, UNET
from layerfield.reproduction.convergence import Trainings
from layerfield.reproduction.measures import Measured, Shown
from layerfield.reproduction.runs import TrainedRun

_NAMES = {CNN: "stacked CNN", UNET: "U-Net"}
_PSNR = "PSNR, dB"


def figures_of_field(measured: Measured, display: Display) -> Iterator[tuple[str, Figure]]:
    """Return figures 3, 5 and 6 of a light field, by name."""
    field = measured.field
    yield "figure3", target_field(field)
    yield "figure5", layer_images(measured, display)
    yield "figure5-shares", layer_shares(measured)
    yield "figure6", reconstructions(measured, display)
    yield "figure6-views", view_maps(measured)
    yield "figure6-iterations", iterations_chart(measured)


def target_field(field: LightField) -> Figure:
    """Figure 3: corner views and the central one."""
    cells = [
        Cell(field.view(n), f"row {n // field.grid[1]}, column {n % field.grid[1]}")
        for n in _places(field)
    ]
    (rows, columns), (height, width) = field.grid, field.size
    title = (
        f"Figure 3. Target light field: {field.name}, {rows}x{columns} views of {width}x{height} px"
    )
    note = "Row 0, column 0 is the view from the top left."
    return sheet(Sheet(title, [("target", "#191c21", cells)], note, width=2.5))


def _places(field: LightField) -> list[int]:
    rows, columns = field.grid
    middle = (rows // 2) * columns + columns // 2
    return [0, columns - 1, middle, (rows - 1) * columns, rows * columns - 1]


def learning_curves(trainings: Mapping[str, Trainings]) -> Figure:
    """Figure 4: PSNR of training and test scenes against epochs."""
    letters = {CNN: "(a)", UNET: "(b)"}
    panels = [
        Panel(
            f"{letters[name]} {_NAMES[name]}",
            "epoch",
            _PSNR,
            [
                line
                for run in each.runs
                for line in _curves(run, COLOURS[name], run is each.runs[0])
            ],
            _optima(each.runs[0]) if each.runs else (),
        )
        for name, each in trainings.items()
    ]
    seeds = ", ".join(f"{_NAMES[n]} {len(each.runs)}" for n, each in trainings.items())
    return chart(f"Figure 4. Training and test PSNR against epochs (seeds: {seeds})", panels)


def _curves(run: TrainedRun, colour: str, first: bool) -> Iterator[Line]:
    epochs = [row["epoch"] for row in run.history]
    name = "U-Net" if colour == COLOURS[UNET] else "stacked CNN"
    for kind, style in (("train", "-"), ("test", ":")):
        if f"{kind}_psnr" in run.history[0]:
            label = f"{name}, {'training' if kind == 'train' else kind} scenes" if first else ""
            values = [row[f"{kind}_psnr"] for row in run.history]
            yield Line(label, epochs, values, colour, style, 1.8 if first else 1.0)


def _optima(run: TrainedRun) -> list[Level]:
    styles = {"train_psnr": ("training", "-"), "test_psnr": ("test", ":")}
    return [
        Level(f"solver, {styles[key][0]} scenes", value, COLOURS["optimum"], styles[key][1])
        for key, value in run.optimum.items()
        if key in styles
    ]


def effort_curves(trainings: Mapping[str, Trainings]) -> Figure:
    """Figure 4 again: test PSNR at equal steps, seconds and operations."""
    panels = []
    for title, unit in (("steps", "steps"), ("seconds", "s"), ("operations", "multiply-adds")):
        lines = [
            Line(
                f"{_NAMES[name]}, test scenes" if run is each.runs[0] else "",
                [_spent(each, run, row, title) for row in run.history],
                [row["test_psnr"] for row in run.history],
                COLOURS[name],
            )
            for name, each in trainings.items()
            for run in each.runs
        ]
        label = "steps" if unit == "steps" else f"training, {unit}"
        first = next(run for each in trainings.values() for run in each.runs)
        optimum = [
            Level("solver, test scenes", first.optimum["test_psnr"], COLOURS["optimum"], ":")
        ]
        panels.append(Panel(f"at equal {title}", label, _PSNR, lines, optimum))
    return chart("Figure 4, by effort. Test PSNR against what training costs", panels)


def _spent(each: Trainings, run: TrainedRun, row: Mapping[str, float], measure: str) -> float:
    if measure == "operations":
        return each.operations(run, row)
    return row["step" if measure == "steps" else measure]


def layer_images(measured: Measured, display: Display) -> Figure:
    """Figure 5: the layers that every contender makes."""
    rows = []
    for shown in measured.shown.values():
        layers = shown.layers[0]
        cells = [
            Cell(layers[k], _layer(display, k), f"mean {f.mean:.3f}, deviation {f.std:.3f}")
            for k, f in enumerate(shown.figures)
        ]
        rows.append((_two_lines(shown), COLOURS[shown.contender.key], cells))
    title = f"Figure 5. Layer images of {measured.field.name} on {display.name}"
    note = "values 0 to 1 as black to white; deviation: standard deviation of the pixels"
    return sheet(Sheet(title, rows, note))


def _layer(display: Display, k: int) -> str:
    near = " (nearest)" if k == 0 else ""
    return f"layer {k}{near}, disparity {display.geometry.parallax[k]:g} px"


def _two_lines(shown: Shown) -> str:
    return shown.contender.label.replace(", ", ",\n")


def layer_shares(measured: Measured) -> Figure:
    """Figure 5 in numbers: how layers share light and detail."""
    shown = measured.shown.values()
    layers = [f"layer {k}" for k in range(len(next(iter(shown)).figures))]
    layers[0] += " (nearest)"
    panels = [
        Bars("light", "share of the mean pixel value, %", [(_name(s), s.light) for s in shown]),
        Bars("detail", "share of the gradient energy, %", [(_name(s), s.detail) for s in shown]),
    ]
    title = f"Figure 5, in numbers. Light and detail of the layers, {measured.field.name}"
    return stacked_bars(title, panels, layers)


def _name(shown: Shown) -> str:
    return shown.contender.label


def reconstructions(measured: Measured, display: Display) -> Figure:
    """Figure 6: views that the layers show, and where they err."""
    field = measured.field
    corner, middle = _places(field)[0], _places(field)[2]
    chosen = [(corner, "top left view"), (middle, "central view")]
    blank = torch.ones_like(field.view(0))
    target = [cell for n, name in chosen for cell in (Cell(field.view(n), name), Cell(blank))]
    rows = [("target", "#191c21", target)]
    for shown in measured.shown.values():
        views = display(shown.layers)
        cells = [
            cell
            for n, name in chosen
            for cell in (
                Cell(views[n], name, f"{shown.by_view[n]:.2f} dB"),
                Cell(error_map(views[n], field.view(n)), f"error, {ERROR_GAIN} times"),
            )
        ]
        rows.append((_two_lines(shown), COLOURS[shown.contender.key], cells))
    title = f"Figure 6. Views of {field.name} as the layers show them, and their errors"
    note = f"errors: mean over colours, {ERROR_GAIN} times, white is none, black is 0.2 or more"
    return sheet(Sheet(title, rows, note))


def view_maps(measured: Measured) -> Figure:
    """Figure 6, uniformity: PSNR of every view on the view grid."""
    shown = list(measured.shown.values())
    values = [value for each in shown for value in each.by_view]
    span = (min(values), max(values))
    rows, columns = measured.field.grid
    cells = [
        Cell(
            torch.tensor(each.by_view).reshape(1, rows, columns),
            _name(each),
            f"all views {each.psnr:.2f} dB, deviation {each.view_spread:.2f} dB",
            span,
        )
        for each in shown
    ]
    lines = [("", "black", cells[first : first + 3]) for first in range(0, len(cells), 3)]
    title = f"Figure 6, uniformity. PSNR of every view in dB, {measured.field.name}"
    note = "place in the map = place of the view on the view grid; brighter is better"
    return sheet(Sheet(title, lines, note, width=2.9))


def iterations_chart(measured: Measured) -> Figure:
    """Figure 6 against iterations: the solvers as curves, networks and optimum as lines."""
    lines = [
        Line(COURSES[name], range(1, course.most + 1), course.psnr[1:], COLOURS[name])
        for name, course in measured.courses.items()
    ]
    levels = [
        Level(f"{_name(s)}: {s.psnr:.2f} dB", s.psnr, COLOURS[s.contender.key], "--")
        for s in measured.shown.values()
        if s.contender.iterations is None
    ]
    best = measured.optimum
    levels.append(Level(f"{best.kind}: {best.psnr:.2f} dB", best.psnr, COLOURS["optimum"], "-."))
    panel = Panel("", "iterations (logarithmic)", _PSNR, lines, levels, log_x=True)
    return chart(f"Figure 6, equivalents. PSNR against iterations, {measured.field.name}", [panel])
