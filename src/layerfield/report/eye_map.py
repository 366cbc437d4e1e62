"""A map of what eyes in and around the view grid are served with."""

import math
from collections.abc import Sequence
from pathlib import Path

import torch
from jaxtyping import Float
from matplotlib.figure import Figure
from torch import Tensor

from layerfield.evaluate import Row
from layerfield.report.plots import Cell, Sheet, save, sheet

_HIGHEST = 60.0  # dB that exact views are drawn with
_INCH = 0.36  # of an eye


def write_eye_map(path: Path, rows: Sequence[Row]) -> None:
    """Write the picture of `eye_map` as PNG."""
    save(eye_map(rows), path)


def eye_map(rows: Sequence[Row]) -> Figure:
    """Draw PSNR against the position of the eye, a map for every row of an evaluation.

    Args:
        rows: with figures for eyes; those of one light field and display stand side by side.
    """
    maps = {id(row): _map(row) for row in rows}
    low, high = torch.cat([m.flatten() for m in maps.values()]).aminmax()
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(f"{row.field}, {row.display}", []).append(row)
    strips = [
        (
            name,
            "black",
            [
                Cell(maps[id(row)], row.label, _caption(row), (low.item(), high.item()))
                for row in group
            ],
        )
        for name, group in groups.items()
    ]
    note = f"PSNR in dB, one eye a cell; {' or '.join(dict.fromkeys(map(_places, rows)))}"
    columns = max(m.shape[-1] for m in maps.values())
    return sheet(Sheet("What eyes see", strips, note, width=max(2.3, _INCH * columns)))


def _map(row: Row) -> Float[Tensor, "1 y x"]:
    assert row.eyes is not None
    found = {(eye.y, eye.x): eye.psnr for eye in row.eyes.by_eye}
    ys, xs = (sorted({place[axis] for place in found}) for axis in (0, 1))
    values = [[_drawn(found.get((y, x), math.nan)) for x in xs] for y in ys]
    return torch.tensor([values])


def _places(row: Row) -> str:
    """Where the outermost eyes are."""
    assert row.eyes is not None
    x, y = (sorted(places) for places in zip(*((e.x, e.y) for e in row.eyes.by_eye), strict=True))
    return f"x {x[0]:g} to {x[-1]:g}, y {y[0]:g} to {y[-1]:g} view steps from the centre"


def _drawn(psnr: float | None) -> float:
    return _HIGHEST if psnr is None else min(psnr, _HIGHEST)


def _caption(row: Row) -> str:
    assert row.eyes is not None
    between = row.eyes.psnr_between
    return f"viewpoints {row.figures.psnr:.2f} dB" + (
        "" if between is None else f", between {between:.2f} dB"
    )
