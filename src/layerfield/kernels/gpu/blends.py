"""The sums that steps are made of, and the balanced start, in one pass over the layers."""

import math
from collections.abc import Sequence

import triton.language as tl
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.gpu.kernel import blocks, kernel

BLOCK = 1024  # pixels of a row at once


def rows_grid(planes: Tensor) -> tuple[int, int]:
    """Return a program for every row of all planes, and for every block of it."""
    return math.prod(planes.shape[:-1]), blocks(planes.shape[-1], BLOCK)


def blend_(
    result: Float[Tensor, "*batch ty tx"],
    shares: Sequence[float],
    shadow: Float[Tensor, "*batch ty tx"],
    bounds: tuple[float, float],
    other: Float[Tensor, "*batch ly lx"] | None,
    *,
    onto: bool,
) -> None:
    """Write a z + b s + c other, z = clamp(s), into the result, or add it; see `Blend`."""
    seen = shadow if other is None else other.contiguous()
    sizes = *result.shape[-2:], *seen.shape[-2:]
    shown = shares[0] != 0 or shares[1] != 0
    _blend[rows_grid(result)](
        result, shadow, seen, *shares, *bounds, *sizes, onto, shown, other is not None, BLOCK
    )


def even_start(
    seen: Float[Tensor, "*batch layer c ly lx"],
    shares: Float[Tensor, "layer 1 ly lx"],
    rest: Float[Tensor, "*batch 1 c 1 1"],
    size: tuple[int, int],
    spared: tuple[int, int, int, int],
) -> Float[Tensor, "*batch layer c ty tx"]:
    """Return shares of what is seen, or the rest, on a torus; see `shared_start`.

    Args:
        seen: A^T W L, and the others as there.
        shares: of it.
        rest: what is taken where there are none.
        size: of the torus.
        spared: rows from and to, columns from and to: pixels that are left as they were in memory.
    """
    *batch, layers, channels, height, width = seen.shape
    result = seen.new_empty(*batch, layers, channels, *size)
    others = rest.expand(*batch, 1, channels, 1, 1).contiguous()
    _share[rows_grid(result)](
        result, seen, shares, others, layers, channels, *size, height, width, *spared, BLOCK
    )
    return result


def cut(
    planes: Float[Tensor, "*batch ty tx"], size: tuple[int, int], bounds: tuple[float, float]
) -> Float[Tensor, "*batch ly lx"]:
    """Return the top left corner of planes, clamped."""
    result = planes.new_empty(*planes.shape[:-2], *size)
    _cut[rows_grid(result)](result, planes, *bounds, *size, *planes.shape[-2:], BLOCK)
    return result


@kernel
def _cut(result, planes, low, high, height, width, rows, columns, BLOCK: tl.constexpr):
    row, x = tl.program_id(0).to(tl.int64), tl.program_id(1) * BLOCK + tl.arange(0, BLOCK)
    plane, y = row // height, row % height
    value = tl.load(planes + (plane * rows + y) * columns + x, x < width)
    tl.store(result + row * width + x, tl.minimum(tl.maximum(value, low), high), x < width)


@kernel
def _blend(
    result, shadow, other, iterate_share, shadow_share, other_share, low, high, rows, columns,
    height, width, ONTO: tl.constexpr, SHOWN: tl.constexpr, OTHER: tl.constexpr,
    BLOCK: tl.constexpr,
):  # fmt: skip
    row, x = tl.program_id(0).to(tl.int64), tl.program_id(1) * BLOCK + tl.arange(0, BLOCK)
    plane, y = row // rows, row % rows
    place, inside = row * columns + x, x < columns
    total = tl.zeros([BLOCK], tl.float32)
    if ONTO:
        total = tl.load(result + place, inside)
    if SHOWN:
        value = tl.load(shadow + place, inside)
        iterate = tl.minimum(tl.maximum(value, low), high)
        total += iterate_share * iterate + shadow_share * value
    if OTHER:
        beneath = x < tl.where(y < height, width, 0)
        seen = tl.load(other + (plane * height + y) * width + x, beneath, 0.0)
        total += other_share * seen
    tl.store(result + place, total, inside)


@kernel
def _share(
    result, seen, shares, others, layers, channels, rows, columns, height, width,
    top, bottom, left, right, BLOCK: tl.constexpr,
):  # fmt: skip
    row, x = tl.program_id(0).to(tl.int64), tl.program_id(1) * BLOCK + tl.arange(0, BLOCK)
    plane, y = row // rows, row % rows
    written = (x < left) | (x >= tl.where((y >= top) & (y < bottom), right, left))
    layer, item, channel = (
        plane // channels % layers,
        plane // (channels * layers),
        plane % channels,
    )
    beneath = x < tl.where(y < height, width, 0)
    light = tl.load(seen + (plane * height + y) * width + x, beneath & written, 0.0)
    share = tl.load(shares + (layer * height + y) * width + x, beneath & written, 0.0)
    rest = tl.load(others + item * channels + channel)
    value = tl.where(share > 0, light * share, rest)
    tl.store(result + row * columns + x, tl.where(beneath, value, 0.0), written & (x < columns))
