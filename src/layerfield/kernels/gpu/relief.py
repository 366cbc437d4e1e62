"""The network on cells of 8x8 pixels: what is known of them, convolutions, and what is added.

Planes are `[item, layer, channel, y, x]`, those of cells the same with what is known of each before
`y`. See `layerfield.solvers.relief`.
"""

# pyright: reportGeneralTypeIssues=false
# Loops that are unrolled, over `static_range`, are for Triton alone to understand.

import math
from collections.abc import Sequence

import triton.language as tl
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.cells import APART, BEYOND, CELL, LEAK, SIGNS
from layerfield.kernels.gpu.blends import BLOCK, rows_grid
from layerfield.kernels.gpu.kernel import blocks, kernel

_CELLS = 128  # of a plane at once
_PARTS = 256


def relieve_(
    shadow: Float[Tensor, "*batch layer c ty tx"],
    size: tuple[int, int],
    bounds: tuple[float, float],
    hidden: Sequence[Sequence[Tensor]],
    last: Float[Tensor, "1 in 3 3"],
) -> None:
    """Add to s what the network makes of it, in place; see `Relief`.

    Args:
        shadow: s, contiguous; the layers are in its top left corner.
        size: height and width of the layers.
        bounds: of z.
        hidden: own and common taps and biases of all convolutions but the last.
        last: taps.
    """
    *_, layers, channels, rows, columns = shadow.shape
    planes, (height, width) = math.prod(shadow.shape[:-2]), size
    down, across = blocks(height, CELL), blocks(width, CELL)
    parts, pictures = blocks(down * across, _CELLS), planes // layers
    seen = shadow.new_empty(planes, SIGNS, down, across)
    # Windows begin two pixels before a cell and two behind its first: they are made of quarters.
    quarters = 2 * down + 1, 2 * across + 1
    split = shadow.new_empty(planes, 4, *quarters)
    _part[planes, blocks(math.prod(quarters), _PARTS)](
        split, shadow, *bounds, rows, columns, height, width, *quarters,
        PART=CELL // 2, APART=APART, PARTS=_PARTS,
    )  # fmt: skip
    _look[planes, parts](
        seen, split, *quarters, down, across, CELL=CELL, SIGNS=SIGNS, BEYOND=BEYOND, CELLS=_CELLS
    )
    # The last takes the mean of all layers from each: common taps are its own with another sign.
    for n, (own, common, bias) in enumerate([*hidden, (last, -last, last.new_zeros(1))]):
        made, is_last = shadow.new_empty(planes, len(own), down, across), n == len(hidden)
        _convolve[pictures, parts, layers](
            made, seen, own, common, bias, channels, down, across, LAYERS=layers,
            IN=own.shape[1], OUT=len(own), ROOM=2 ** math.ceil(math.log2(len(own))),
            LEAK=1.0 if is_last else LEAK, RESIDUAL=n > 0 and not is_last, CELLS=_CELLS,
        )  # fmt: skip
        seen = made
    _add[rows_grid(shadow)](
        shadow, seen, bounds[1] - bounds[0], rows, columns, height, width, down, across,
        CELL=CELL, BLOCK=BLOCK,
    )  # fmt: skip


@kernel
def _part(
    parts, shadow, low, high, rows, columns, height, width, down, across,
    PART: tl.constexpr, APART: tl.constexpr, PARTS: tl.constexpr,
):  # fmt: skip
    """Least, most, and what goes beyond either bound, of quarters of windows: each is seen once."""
    n, plane = tl.program_id(1) * PARTS + tl.arange(0, PARTS), tl.program_id(0).to(tl.int64)
    inside, count = n < down * across, down * across
    y, x = n // across * PART - APART, n % across * PART - APART
    pixels, share = shadow + plane * rows * columns, 1 / (high - low)
    least = tl.full([PARTS], float("inf"), tl.float32)
    most = tl.full([PARTS], float("-inf"), tl.float32)
    over, under = tl.zeros([PARTS], tl.float32), tl.zeros([PARTS], tl.float32)
    for pixel in tl.static_range(PART * PART):
        pixel_y = tl.minimum(tl.maximum(y + pixel // PART, 0), height - 1)
        pixel_x = tl.minimum(tl.maximum(x + pixel % PART, 0), width - 1)
        value = (tl.load(pixels + pixel_y * columns + pixel_x, inside, 0.0) - low) * share
        least, most = tl.minimum(least, value), tl.maximum(most, value)
        over += tl.maximum(value - 1, 0.0)
        under += tl.maximum(-value, 0.0)
    parts += plane * 4 * count + n
    tl.store(parts, least, inside)
    tl.store(parts + count, most, inside)
    tl.store(parts + 2 * count, over, inside)
    tl.store(parts + 3 * count, under, inside)


@kernel
def _look(
    known, parts, part_rows, part_columns, down, across,
    CELL: tl.constexpr, SIGNS: tl.constexpr, BEYOND: tl.constexpr, CELLS: tl.constexpr,
):  # fmt: skip
    """What is known of cells of a plane: means over four windows of four quarters each."""
    n, plane = tl.program_id(1) * CELLS + tl.arange(0, CELLS), tl.program_id(0).to(tl.int64)
    inside, cells, count = n < down * across, down * across, part_rows * part_columns
    first = parts + plane * 4 * count + n // across * 2 * part_columns + n % across * 2
    falls, rises = tl.zeros([CELLS], tl.float32), tl.zeros([CELLS], tl.float32)
    over, under = tl.zeros([CELLS], tl.float32), tl.zeros([CELLS], tl.float32)
    beneath, above = tl.zeros([CELLS], tl.float32), tl.zeros([CELLS], tl.float32)
    for window in tl.static_range(4):
        least = tl.full([CELLS], float("inf"), tl.float32)
        most = tl.full([CELLS], float("-inf"), tl.float32)
        for quarter in tl.static_range(4):
            part = first + (window // 2 + quarter // 2) * part_columns + window % 2 + quarter % 2
            least = tl.minimum(least, tl.load(part, inside, 0.0))
            most = tl.maximum(most, tl.load(part + count, inside, 0.0))
            over += tl.load(part + 2 * count, inside, 0.0)
            under += tl.load(part + 3 * count, inside, 0.0)
        fall = tl.minimum(tl.maximum(least, 0.0), 1.0)
        rise = 1 - tl.minimum(tl.maximum(most, 0.0), 1.0)
        falls += fall
        rises += rise
        beneath += least - fall
        above += most - (1 - rise)
    known += plane * SIGNS * cells + n
    mean: tl.constexpr = BEYOND / (CELL * CELL)
    tl.store(known, falls / 4, inside)
    tl.store(known + cells, rises / 4, inside)
    tl.store(known + 2 * cells, mean * over / 4, inside)
    tl.store(known + 3 * cells, -mean * under / 4, inside)
    tl.store(known + 4 * cells, BEYOND * beneath / 4, inside)
    tl.store(known + 5 * cells, BEYOND * above / 4, inside)


@kernel
def _convolve(
    result, seen, own, common, bias, channels, down, across, LAYERS: tl.constexpr,
    IN: tl.constexpr, OUT: tl.constexpr, ROOM: tl.constexpr, LEAK: tl.constexpr,
    RESIDUAL: tl.constexpr, CELLS: tl.constexpr,
):  # fmt: skip
    """Cells of layer k: its own taps, and common ones for the mean of all layers."""
    n, k = tl.program_id(1) * CELLS + tl.arange(0, CELLS), tl.program_id(2)
    item, channel = tl.program_id(0) // channels, tl.program_id(0) % channels
    inside, cells, o = n < down * across, down * across, tl.arange(0, ROOM)
    first, behind = item * LAYERS * channels + channel, channels * IN * cells
    mine = tl.load(bias + o, o < OUT, 0.0)[:, None] + tl.zeros([ROOM, CELLS], tl.float32)
    for tap in range(9):
        y = tl.minimum(tl.maximum(n // across + tap // 3 - 1, 0), down - 1)
        x = tl.minimum(tl.maximum(n % across + tap % 3 - 1, 0), across - 1)
        pixel = seen + first.to(tl.int64) * IN * cells + y * across + x
        for i in tl.static_range(IN):
            mean = tl.zeros([CELLS], tl.float32)
            for layer in tl.static_range(LAYERS):
                mean += tl.load(pixel + layer * behind + i * cells, inside, 0.0)
            alone = tl.load(pixel + k * behind + i * cells, inside, 0.0)
            taps = (o * IN + i) * 9 + tap
            mine += tl.load(own + taps, o < OUT, 0.0)[:, None] * alone[None, :]
            mine += tl.load(common + taps, o < OUT, 0.0)[:, None] * (mean / LAYERS)[None, :]
    mine = tl.where(mine > 0, mine, LEAK * mine)
    plane = (first + k * channels).to(tl.int64) * OUT * cells
    place, there = plane + o[:, None] * cells + n[None, :], inside[None, :] & (o[:, None] < OUT)
    if RESIDUAL:
        mine += tl.load(seen + place, there, 0.0)
    tl.store(result + place, mine, there)


@kernel
def _add(
    shadow, change, share, rows, columns, height, width, down, across,
    CELL: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Add a share of the change of cells to pixels, between the middles of cells linearly."""
    row, x = tl.program_id(0).to(tl.int64), tl.program_id(1) * BLOCK + tl.arange(0, BLOCK)
    plane, y = row // rows, row % rows
    beneath = x < tl.where(y < height, width, 0)
    place_y = tl.maximum((y.to(tl.float32) + 0.5) / CELL - 0.5, 0.0)
    place_x = tl.maximum((x.to(tl.float32) + 0.5) / CELL - 0.5, 0.0)
    top, left = place_y.to(tl.int32), place_x.to(tl.int32)
    below, right = tl.minimum(top + 1, down - 1), tl.minimum(left + 1, across - 1)
    fy, fx = place_y - top, place_x - left
    change += plane * down * across
    upper, lower = change + top * across, change + below * across
    first = (
        tl.load(upper + left, beneath, 0.0) * (1 - fx) + tl.load(upper + right, beneath, 0.0) * fx
    )
    second = tl.load(lower + left, beneath, 0.0) * (1 - fx)
    second += tl.load(lower + right, beneath, 0.0) * fx
    pixel = shadow + row * columns + x
    value = tl.load(pixel, beneath, 0.0) + share * (first * (1 - fy) + second * fy)
    tl.store(pixel, value, beneath)
