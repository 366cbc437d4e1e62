"""What a Newton step is made of but slopes and its linear system; as `kernels.newton_passes`."""

from collections.abc import Sequence

import triton.language as tl
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.gpu.blends import BLOCK, rows_grid
from layerfield.kernels.gpu.kernel import kernel


def before_(
    right: Float[Tensor, "*batch ty tx"],
    shadow: Float[Tensor, "*batch ly lx"],
    slope: Float[Tensor, "*batch ly lx"],
    scale: Float[Tensor, "*batch ly lx"],
    last: Float[Tensor, "*batch ly lx"],
    terms: Sequence[float],
    is_new: bool,
    is_first: bool,
) -> None:
    """Write the right-hand side, the dual into the slope, and D into the scale if that is new."""
    _before[rows_grid(right)](
        right, shadow, slope, scale, last, *terms, *right.shape[-2:], *shadow.shape[-2:],
        NEW=is_new, FIRST=is_first, BLOCK=BLOCK,
    )  # fmt: skip


def behind_(
    dual: Float[Tensor, "*batch layer c ly lx"],
    shadow: Float[Tensor, "*batch layer c ly lx"],
    last: Float[Tensor, "*batch layer c ly lx"],
    scale: Float[Tensor, "*batch layer c ly lx"],
    solved: Float[Tensor, "*batch layer c ty tx"],
    boldness: Float[Tensor, "*batch 1 1 1 1"],
    terms: Sequence[float],
) -> None:
    """Write s after the step into the dual."""
    planes = dual.shape[-4] * dual.shape[-3]
    _behind[rows_grid(dual)](
        dual, shadow, last, scale, solved, boldness, *terms, planes, *solved.shape[-2:],
        *dual.shape[-2:], AGAIN=terms[1] != 0, BLOCK=BLOCK,
    )  # fmt: skip


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
    planes, rows, columns, height, width, AGAIN: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    row, x = tl.program_id(0).to(tl.int64), tl.program_id(1) * BLOCK + tl.arange(0, BLOCK)
    plane, y = row // height, row % height
    inside, place = x < width, row * width + x
    shadow, dual = tl.load(shadows + place, inside), tl.load(duals + place, inside)
    scale = tl.load(scales + place, inside, 1.0)
    found = tl.load(solved + (plane * rows + y) * columns + x, inside)
    bold = tl.load(boldness + plane // planes)
    iterate = tl.minimum(tl.maximum(shadow, low), high)
    change = found / scale
    if AGAIN:
        change += momentum * (shadow - tl.load(last + place, inside))
    tl.store(duals + place, bold * change + iterate + kept * dual, inside)
