"""Synthesizers x light fields x displays -> rows of figures, the reference beside every method."""

import dataclasses
import json
import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from layerfield.display import Display
from layerfield.display_spec import Spec
from layerfield.eyes import EyeFigures, judge_eyes
from layerfield.light_field import EyeViews, LightField
from layerfield.methods import NetworkMethod
from layerfield.metrics import (
    LayerFigures,
    decibels,
    excess,
    finite,
    interior,
    layer_figures,
    mean_square_error,
    ssim,
)
from layerfield.own_process import in_own_process, peak_megabytes
from layerfield.panels import dequantise
from layerfield.problem import Problem
from layerfield.provenance import provenance
from layerfield.reference import Reference, reference, store_reference
from layerfield.solvers.rounding import panel_codes
from layerfield.synthesizer import find_method, pose, spelled, synthesize
from layerfield.weights import WEIGHT_SUFFIX


@dataclass(frozen=True)
class Figures:
    """What layers show, judged from their quantised panel images.

    Args:
        psnr: whole image, all views together, dB; as the next five on the values of the files.
        psnr_linear: the same in light; another figure where the display has a transfer.
        psnr_interior: the same without a border.
        ssim: mean over views, clipped to 0..1.
        psnr_view_min: of the worst view, dB.
        psnr_view_max: of the best view, dB.
        psnr_view_std: standard deviation over views, dB.
        psnr_by_view: of every view, row by row from the top left, dB.
        layers: mean, standard deviation, gradient energy and peak of every layer, front to back.
    """

    psnr: float
    psnr_linear: float
    psnr_interior: float
    ssim: float
    psnr_view_min: float
    psnr_view_max: float
    psnr_view_std: float
    psnr_by_view: list[float]
    layers: list[LayerFigures]


def figures(layers: Tensor, field: LightField, display: Display) -> Figures:
    """Return the figures of quality of layers, light from 0 to 1."""
    errors = [_view_errors(layers, field, display, i) for i in range(len(field))]
    by_view = [decibels(error.values) for error in errors]
    values, light, inside, similarity = (
        statistics.fmean(each) for each in zip(*errors, strict=True)
    )
    return Figures(
        psnr=decibels(values),
        psnr_linear=decibels(light),
        psnr_interior=decibels(inside),
        ssim=similarity,
        psnr_view_min=min(by_view),
        psnr_view_max=max(by_view),
        psnr_view_std=_spread(by_view),
        psnr_by_view=by_view,
        layers=layer_figures(layers),
    )


def light_error(layers: Tensor, field: LightField, display: Display) -> float:
    """Return the mean square error of the light that layers show, all views alike."""
    return Problem.of(display, field.kept).mean_square_error(layers)


class _ViewErrors(NamedTuple):
    """Mean square errors of one view: of values, of light, and of values without a border."""

    values: float
    light: float
    interior: float
    ssim: float


def _view_errors(layers: Tensor, field: LightField, display: Display, index: int) -> _ViewErrors:
    light, wanted = display.view(layers, index), field.view(index)
    shown = display.transfer.encode(light)
    return _ViewErrors(
        mean_square_error(shown, wanted),
        mean_square_error(light, display.transfer.decode(wanted)),
        mean_square_error(*(interior(view, display.margin) for view in (shown, wanted))),
        ssim(shown[None], wanted[None]),
    )


def _spread(decibels: Sequence[float]) -> float:
    """Return the standard deviation; 0 if all views are perfect, infinite if only some are."""
    perfect = [math.isinf(value) for value in decibels]
    if any(perfect):
        return 0.0 if all(perfect) else math.inf
    return statistics.pstdev(decibels)


@dataclass(frozen=True)
class Row:
    """One method on one light field and display; mean square errors are those of light."""

    field: str
    display: str
    method: str
    iterations: int
    seconds: float
    peak_mb: float | None
    bits: int
    mean_square_error: float
    figures: Figures
    made_with: dict[str, Any]
    details: dict[str, float | str] = dataclasses.field(default_factory=dict)
    reference: Reference | None = None
    eyes: EyeFigures | None = None
    grid: tuple[int, int] | None = None  # rows and columns of the viewpoints; None for a list

    @property
    def label(self) -> str:
        """The method and its iterations."""
        return spelled(self.method, self.iterations)

    def as_record(self) -> dict[str, Any]:
        """Return the row as plain data for JSON; figures side by side with the rest."""
        apart = {"figures", "reference", "eyes"}
        record = {k: v for k, v in asdict(self).items() if k not in apart}
        record |= asdict(self.figures) | {
            "layers": [layer._asdict() for layer in self.figures.layers]
        }
        if self.reference is not None:
            record |= {
                "excess": excess(self.mean_square_error, self.reference.mean_square_error),
                "reference_psnr": self.reference.psnr,
                "reference_kind": self.reference.kind,
                "reference_method": self.reference.method,
                "reference_gap_db": self.reference.gap_db,
            }
        if self.eyes is not None:
            record["psnr_between"] = self.eyes.psnr_between
            record["eyes"] = [eye._asdict() for eye in self.eyes.by_eye]
        return record


def parse_methods(text: str, iterations: int | None = None) -> list[tuple[str, int]]:
    """Parse `a,b:100,c:10` into methods and iterations.

    Args:
        text: method names, each with its iterations if wanted.
        iterations: for methods without their own; the methods' own numbers if not given.

    Raises:
        ValueError: an unknown method or not a number of iterations.

    >>> parse_methods("nmf:50,fourier-admm,unet")
    [('nmf', 50), ('fourier-admm', 10), ('unet', 0)]
    """
    chosen = []
    for entry in map(str.strip, text.split(",")):
        name, colon, count = _parted(entry)
        method = find_method(name)
        if colon and not count.isdecimal():
            raise ValueError(f"found '{entry}', expected name:iterations, as {name}:10")
        general = None if isinstance(method, NetworkMethod) else iterations
        chosen.append((name, method.count(int(count) if colon else general)))
    return chosen


def _parted(entry: str) -> tuple[str, str, str]:
    """Part at the last colon, unless that is in the path of a weight file."""
    name, colon, count = entry.rpartition(":")
    in_path = "/" in count or count.endswith(WEIGHT_SUFFIX)
    return (name, colon, count) if colon and not in_path else (entry, "", "")


def evaluate(
    fields: Sequence[LightField],
    displays: Sequence[Display],
    methods: Sequence[tuple[str, int]],
    *,
    bits: int = 16,
    isolate: bool = False,
    around: Sequence[EyeViews] = (),
    tick: Callable[[str], None] | None = None,
) -> list[Row]:
    """Run every method on every light field and display.

    Args:
        fields: light fields, with the views of the displays.
        displays: displays.
        methods: names and iterations; those that do not serve a display are an error.
        bits: of the panel images that are judged, 8 or 16.
        isolate: a process for each run, so that its peak memory is its own. In a script this
            needs the usual `if __name__ == "__main__":`.
        around: what eyes in and around the view grid of each light field see, to be judged, too.
        tick: called with a word on what is being done, for progress displays.

    Returns:
        Rows in order of fields, displays and methods.

    Raises:
        ValueError: views around some light fields only.
    """
    if around and len(around) != len(fields):
        raise ValueError(f"found views around {len(around)} of {len(fields)} light fields")
    rows = []
    for field, eyes in zip(fields, around or [None] * len(fields), strict=True):
        for display in displays:
            rows += _compare(field, display, methods, bits, isolate, eyes, tick)
    return rows


def _compare(
    field: LightField,
    display: Display,
    methods: Sequence[tuple[str, int]],
    bits: int,
    isolate: bool,
    around: EyeViews | None,
    tick: Callable[[str], None] | None,
) -> list[Row]:
    problem = pose(replace(field, between=None), display)
    rows = []
    for name, iterations in methods:
        if tick is not None:
            tick(f"{field.name}, {display.name}: {spelled(name, iterations)}")
        job = _Job(field, display.spec, name, iterations, bits, own_process=isolate)
        row, codes = in_own_process(_measure, job) if isolate else _measure(job)
        if around is not None:
            layers = dequantise(torch.from_numpy(codes), display.transfer)
            row = replace(row, eyes=judge_eyes(layers, display, around))
        rows.append(row)
    if tick is not None:
        tick(f"{field.name}, {display.name}: reference")
    found = reference(problem, tick=tick)
    for row in rows:
        found = found.improved_by(row.mean_square_error, row.label)
    store_reference(problem, found)
    return [replace(row, reference=found) for row in rows]


@dataclass(frozen=True, eq=False)
class _Job:
    field: LightField
    spec: Spec
    method: str
    iterations: int
    bits: int
    own_process: bool = False


def _measure(job: _Job) -> tuple[Row, np.ndarray]:
    """Return a row and the codes of its layers, which outlive a process as an array only."""
    field, display = job.field, Display(job.spec)
    if job.own_process:
        _warm_up(field, display, job)
    solution = synthesize(field, display, method=job.method, iterations=job.iterations)
    peak = peak_megabytes() if job.own_process else None
    transfer, solved = display.transfer, solution.problem or pose(field, display)
    codes = panel_codes(solved, solution.layers, bits=job.bits, transfer=transfer)
    layers = dequantise(codes, transfer)
    row = Row(
        field=field.name,
        display=display.name,
        method=find_method(job.method).title,
        iterations=solution.iterations,
        seconds=solution.seconds,
        peak_mb=peak,
        bits=job.bits,
        mean_square_error=light_error(layers, field, display),
        figures=figures(layers, field, display),
        made_with=provenance(field.stored.device),
        details=dict(solution.details) | _targets(field),
        grid=display.geometry.grid,
    )
    return row, codes.cpu().numpy()


def _targets(field: LightField) -> dict[str, float | str]:
    return {} if field.between is None else {"weight_between": field.between.weight}


def _warm_up(field: LightField, display: Display, job: _Job) -> None:
    """Start threads and libraries on a corner of the field, so that the clock does not see it."""
    corner = replace(field, stored=field.stored[..., :32, :32].contiguous(), between=None)
    synthesize(corner, display, method=job.method, iterations=min(job.iterations, 1))


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Write rows as a JSON list of records; a perfect figure, infinite in dB, becomes null."""
    records = [finite(row.as_record()) for row in rows]
    path.write_text(json.dumps(records, indent=2), "utf-8")


def tables(rows: Sequence[Row]) -> list[tuple[str, list[list[str]]]]:
    """Return a title and lines of text, a heading first, for each light field and display."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.field, row.display), []).append(row)
    return [(_title(group[0]), _lines(group)) for group in groups.values()]


def _title(row: Row) -> str:
    found = row.reference
    title = f"{row.field} on {row.display}"
    if found is None:
        return title
    bound = "" if found.gap_db is None else f", certified to {found.gap_db:.3f} dB"
    light = " in linear light" if _differ(row) else ""
    return f"{title}: {found.kind} {found.psnr:.2f} dB{light} ({found.method}{bound})"


def _differ(row: Row) -> bool:
    """Say whether figures of encoded values are others than those of light."""
    return row.figures.psnr != row.figures.psnr_linear


def _lines(rows: Sequence[Row]) -> list[list[str]]:
    isolated = all(row.peak_mb is not None for row in rows)
    both = any(map(_differ, rows))
    between = any(row.eyes and row.eyes.psnr_between for row in rows)
    heading = [
        "method",
        "PSNR dB",
        *["linear"] * both,
        *["between"] * between,
        "interior",
        "excess",
        "SSIM",
        "views dB",
        "s",
        "layer means",
    ]
    lines = [[*heading, *["MB"] * isolated]]
    for row in rows:
        found, reached = row.figures, row.mean_square_error
        lines.append(
            [
                row.label,
                f"{found.psnr:.2f}",
                *[f"{found.psnr_linear:.2f}"] * both,
                *[_between(row)] * between,
                f"{found.psnr_interior:.2f}",
                f"{excess(reached, row.reference.mean_square_error):.1%}" if row.reference else "",
                f"{found.ssim:.4f}",
                f"{found.psnr_view_min:.1f}-{found.psnr_view_max:.1f}",
                f"{row.seconds:.2f}",
                " ".join(f"{layer.mean:.2f}" for layer in found.layers),
                *([f"{row.peak_mb:.0f}"] if isolated and row.peak_mb else []),
            ]
        )
    return lines


def _between(row: Row) -> str:
    found = row.eyes and row.eyes.psnr_between
    return "" if found is None else f"{found:.2f}"
