"""What a Newton step is made of but slopes and its linear system; see `layerfield.kernels`."""

import torch
import triton.language as tl
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.gpu.blends import BLOCK, rows_grid
from layerfield.kernels.gpu.kernel import kernel

Layers = Float[Tensor, "*batch 1 layer c ly lx"]
Torus = Float[Tensor, "*batch 1 layer c ty tx"]


def before(
    terms: tuple[float, ...],
    shadow: Layers,
    slope: Layers,
    curvature: Layers | None,
    last: Layers | None,
    torus: tuple[int, int],
) -> tuple[Torus, Layers, Layers]:
    """Return the right-hand side, the dual, which is written into the slope, and D.

    Args:
        terms: as `kernels.newton_passes.Before`.
        shadow: s.
        slope: g.
        curvature: that D follows from, which is written into it; without one D stays as it was.
        last: D of the step before; without one the dual follows from the slope.
        torus: its rows and columns.
    """
    scale = last if curvature is None else curvature
    assert scale is not None
    right = torch.empty(*shadow.shape[:-2], *torus, device=shadow.device)
    ago = scale if last is None else last
    _before[rows_grid(right)](
        right, shadow, slope, scale, ago, *terms, *torus, *shadow.shape[-2:],
        NEW=curvature is not None, FIRST=last is None, BLOCK=BLOCK,
    )  # fmt: skip
    return right, slope, scale


def behind(
    terms: tuple[float, ...],
    shadow: Layers,
    last: Layers | None,
    dual: Layers,
    scale: Layers,
    solved: Torus,
    boldness: Float[Tensor, "*batch 1 1 1 1 1"],
) -> Layers:
    """Return s after the step, which is written into the dual.

    Args:
        terms: as `kernels.newton_passes.Behind`.
        shadow: s.
        last: s of one step ago.
        dual: u.
        scale: D.
        solved: of the linear system.
        boldness: how far to go.
    """
    ago = shadow if last is None else last
    planes = shadow.shape[-5] * shadow.shape[-4] * shadow.shape[-3]
    _behind[rows_grid(dual)](
        dual, shadow, ago, scale, solved, boldness, *terms, planes, *solved.shape[-2:],
        *dual.shape[-2:], BLOCK=BLOCK,
    )  # fmt: skip
    return dual


@kernel
def _before(
    rights, shadows, slopes, scales, last, rho, trust, low, high, weight, least,
    rows, columns, height, width, NEW: tl.constexpr, FIRST: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    row, x = tl.program_id(0).to(tl.int64), tl.program_id(1) * BLOCK + tl.arange(0, BLOCK)
    plane, y = row // rows, row % rows
    beneath = x < tl.where(y < height, width, 0)
    place = (plane * height + y) * width + x
    shadow = tl.load(shadows + place, beneath, 0.0)
    slope = tl.load(slopes + place, beneath, 0.0)
    scale = tl.load(scales + place, beneath, 1.0)
    ago = tl.load(last + place, beneath, 1.0)
    if NEW:
        scale = tl.sqrt(tl.maximum(scale / weight, least))
        tl.store(scales + place, scale, beneath)
    iterate = tl.minimum(tl.maximum(shadow, low), high)
    if FIRST:
        held = ((iterate <= low) & (slope > 0)) | ((iterate >= high) & (slope < 0))
        dual = tl.where(held, -slope / (rho * scale * scale), 0.0)
    else:
        turned = ago / scale
        dual = (shadow - iterate) * turned * turned  # of the same force, rho D^2 u
    right = slope / (rho * scale) + trust * scale * dual
    tl.store(slopes + place, dual, beneath)
    tl.store(rights + row * columns + x, tl.where(beneath, right, 0.0), x < columns)


@kernel
def _behind(
    duals, shadows, last, scales, solved, boldness, kept, momentum, low, high,
    planes, rows, columns, height, width, BLOCK: tl.constexpr,
):  # fmt: skip
    row, x = tl.program_id(0).to(tl.int64), tl.program_id(1) * BLOCK + tl.arange(0, BLOCK)
    plane, y = row // height, row % height
    inside, place = x < width, row * width + x
    shadow, dual = tl.load(shadows + place, inside), tl.load(duals + place, inside)
    ago, scale = tl.load(last + place, inside), tl.load(scales + place, inside, 1.0)
    found = tl.load(solved + (plane * rows + y) * columns + x, inside)
    bold = tl.load(boldness + plane // planes)
    iterate = tl.minimum(tl.maximum(shadow, low), high)
    change = found / scale + momentum * (shadow - ago)
    tl.store(duals + place, bold * change + iterate + kept * dual, inside)
