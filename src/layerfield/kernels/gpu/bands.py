"""What layers contribute around the views, for every pixel of the band by itself.

A^T (1 - M) W A of any viewpoints; see `layerfield.band`.
"""

# pyright: reportGeneralTypeIssues=false
# Loops that are unrolled, over `static_range`, are for Triton alone to understand.

import math
from collections.abc import Sequence

import triton.language as tl
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.gpu.kernel import blocks, kernel
from layerfield.kernels.gpu.light_paths import taps_on, weight_of, weights_on, window_of
from layerfield.projection import Projection

_WARPS = 2
_BLOCK = 64 * _WARPS  # pixels, two a thread


def add_band_(
    result: Float[Tensor, "*batch layer c ty tx"],
    layers: Float[Tensor, "*batch layer c ty tx"],
    factor: float,
    bounds: tuple[float, float],
    projection: Projection,
    weights: Sequence[float],
    view_size: tuple[int, int],
) -> None:
    """Add a multiple of A^T (1 - M) W A of layers clamped to bounds, in place."""
    number, channels, ty, tx = layers.shape[-4:]
    (height, width), (my, mx) = view_size, projection.margin
    # Rows that view pixels below the views look at; then, of the other rows, columns beside them.
    below = min(ty, ty - height + 2 * my) if ty > height else 0
    beside = min(tx, tx - width + 2 * mx) if tx > width else 0
    pixels = below * tx + (ty - below) * beside
    if pixels == 0:
        return
    taps, pictures = taps_on(projection, layers.device), math.prod(layers.shape[:-4]) * channels
    _add_band[blocks(pixels, _BLOCK), pictures, number](
        result, layers, weights_on(tuple(weights), layers.device), *taps[:3], factor, *bounds,
        len(weights) // taps.together, channels, ty, tx, height, width, below, beside, pixels,
        VIEWS=taps.together, LAYERS=number, TAPS=taps.top.shape[-1], KNOWN=taps.rows, BLOCK=_BLOCK,
        num_warps=_WARPS,
    )  # fmt: skip


@kernel
def _add_band(
    result, layers, weights, top, left, weight, factor, low, high, groups, channels, ty, tx,
    height, width, below, beside, pixels, VIEWS: tl.constexpr, LAYERS: tl.constexpr,
    TAPS: tl.constexpr, KNOWN: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Pixels of one channel of one layer."""
    n, mine = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK), tl.program_id(2)
    for k in tl.static_range(LAYERS):
        if mine == k:
            _add_to_layer(
                result, layers, weights, top, left, weight, factor, low, high, groups, channels,
                ty, tx, height, width, below, beside, pixels, n, tl.program_id(1),
                k, VIEWS, LAYERS, TAPS, KNOWN, BLOCK,
            )  # fmt: skip


@kernel
def _add_to_layer(
    result, layers, weights, top, left, weight, factor, low, high, groups, channels, ty, tx,
    height, width, below, beside, pixels, n, picture, k: tl.constexpr, VIEWS: tl.constexpr,
    LAYERS: tl.constexpr, TAPS: tl.constexpr, KNOWN: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    item, channel = picture // channels, picture % channels
    plane = (item * LAYERS * channels + channel).to(tl.int64) * ty * tx
    behind = channels * ty * tx
    inside, is_below, rest = n < pixels, n < below * tx, n - below * tx
    across = tl.maximum(beside, 1)
    # Both begin at the end of the views, and run on past the end of the torus.
    y = _down(height + tl.where(is_below, n // tx, below + rest // across), ty)
    x = tl.where(is_below, n % tx, _down(width + rest % across, tx))
    total = tl.zeros([BLOCK], tl.float32)
    for group in range(groups):
        for column in tl.static_range(VIEWS):
            i = group * VIEWS + column
            share = tl.load(weights + i)
            for tap in tl.static_range(TAPS):
                row, line = window_of(top, left, group, column, VIEWS, LAYERS, TAPS, k, tap, KNOWN)
                view_y, view_x = _up(y - row, ty), _up(x - line, tx)
                of_band = inside & ((view_y >= height) | (view_x >= width))
                seen = tl.zeros([BLOCK], tl.float32)
                for j in tl.static_range(LAYERS):
                    for beside_it in tl.static_range(TAPS):
                        row, line = window_of(
                            top, left, group, column, VIEWS, LAYERS, TAPS, j, beside_it, KNOWN
                        )
                        place = _down(view_y + row, ty) * tx + _down(view_x + line, tx)
                        value = tl.load(layers + plane + j * behind + place, of_band, 0.0)
                        value = tl.minimum(tl.maximum(value, low), high)
                        seen += weight_of(weight, i, LAYERS, TAPS, j, beside_it) * value
                # What is not of the band may have been moved into the bounds.
                seen *= share * weight_of(weight, i, LAYERS, TAPS, k, tap)
                total += tl.where(of_band, seen, 0.0)
    place = plane + k * behind + y * tx + x
    tl.store(result + place, tl.load(result + place, inside, 0.0) + factor * total, inside)


@kernel
def _up(place, length):
    """A place on the torus that may lie before its first pixel."""
    return tl.where(place < 0, place + length, place)


@kernel
def _down(place, length):
    """The same, behind its last."""
    return tl.where(place >= length, place - length, place)
