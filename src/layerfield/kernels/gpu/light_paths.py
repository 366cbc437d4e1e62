"""What all light paths of a display bring to the pixels that they meet: every pixel asks its views.

    first_k  = sum_i w_i A_ik^T o_ik (a shown_i + b L_i)
    second_k = sum_i w_i A_ik^T o_ik^2

as of `layerfield.kernels.light_paths`. The programs of a block of pixels write every pixel once,
each by itself: the order of sums, and with it what comes out, does not change from run to run.
"""

# pyright: reportGeneralTypeIssues=false
# Loops that are unrolled, over `static_range`, are for Triton alone to understand.

from collections.abc import Sequence
from functools import cache
from itertools import chain
from typing import NamedTuple
from weakref import WeakKeyDictionary

import torch
import triton.language as tl
from jaxtyping import Float, Num
from torch import Tensor

from layerfield.kept_views import KeptViews
from layerfield.kernels.gpu.kernel import blocks, kernel
from layerfield.projection import Projection

_WARPS = 4  # of a program
_BLOCK = 64 * _WARPS  # pixels of a row, two a thread
_LOOKED_UP = WeakKeyDictionary[KeptViews, Tensor]()  # as long as the views are kept


class Rows(NamedTuple):
    """Views of whole pixels on a grid of even rows; a kernel is compiled for them.

    Args:
        left: of every view of a row, layer by layer, the column where its window begins.
        top: of every layer, the row where the windows of the first row of views begin.
        step: by how much those of the next one begin lower.
    """

    left: tuple[int, ...]
    top: tuple[int, ...]
    step: tuple[int, ...]


class Taps(NamedTuple):
    """Where views look: `[view, layer, tap]` rows and columns of windows in the layer, and weights.

    Args:
        top: rows.
        left: columns.
        weight: 0 where there are fewer windows than the most.
        rows: the same of views on a grid.
    """

    top: Tensor
    left: Tensor
    weight: Tensor
    rows: Rows | None

    @property
    def together(self) -> int:
        """How many views a row has; each is its own where they are no grid."""
        return 1 if self.rows is None else len(self.rows.left) // len(self.rows.top)


@cache
def taps_on(projection: Projection, device: torch.device) -> Taps:
    """Return the windows of a projection; kept for good, as what is recorded relies on them."""
    most = max(len(taps) for layers in projection.taps for taps in layers)
    windows = [
        window
        for layers in projection.taps
        for taps in layers
        for window in (*taps, *[(taps[0][0], taps[0][1], 0.0)] * (most - len(taps)))
    ]
    shape = len(projection.taps), len(projection.taps[0]), most
    found = (torch.tensor(each, device=device).view(shape) for each in zip(*windows, strict=True))
    top, left, weight = found
    return Taps(top.int(), left.int(), weight.float(), _rows_of(projection))


def _rows_of(projection: Projection) -> Rows | None:
    """Return the rows of views, if they are a grid of whole pixels."""
    if not projection.is_whole:
        return None
    places = [[taps[0][:2] for taps in layers] for layers in projection.taps]
    tops = [tuple(top for top, _ in view) for view in places]
    lefts = [tuple(left for _, left in view) for view in places]
    length = next((n for n, top in enumerate(tops) if top != tops[0]), len(tops))
    below = tops[length] if length < len(tops) else tops[0]
    step = tuple(there - here for there, here in zip(below, tops[0], strict=True))
    for n in range(len(tops)):
        row, column = divmod(n, length)
        expected = tuple(top + row * down for top, down in zip(tops[0], step, strict=True))
        if tops[n] != expected or lefts[n] != lefts[column]:
            return None
    return Rows(tuple(chain.from_iterable(lefts[:length])), tops[0], step)


@cache
def weights_on(weights: tuple[float, ...], device: torch.device) -> Tensor:
    """Return the weights of the views there; kept as windows are."""
    return torch.tensor(weights, device=device)


def add_up(
    projection: Projection,
    stored: Tensor,
    weights: Sequence[float],
    first: Float[Tensor, "*batch 1 chosen c ly lx"],
    layers: Float[Tensor, "*batch 1 layer c ly lx"],
    second: Float[Tensor, "*batch 1 chosen c ly lx"] | None,
    shares: tuple[float, float],
    every: int,
    *,
    is_product: bool,
    only: int | None = None,
) -> Float[Tensor, " item"]:
    """Write into `first` and `second`, and return the errors, of every item of a batch.

    Args:
        projection: A.
        stored: views, contiguous, codes or values.
        weights: of the views.
        first: what is written.
        layers: P.
        second: what is written, or none.
        shares: a and b.
        every: how many views there are to one whose error is found; 0 for none.
        is_product: whether the link is.
        only: the only layer that anything is found for.
    """
    *_, views, channels, height, width = stored.shape
    number, (rows, columns) = layers.shape[-4], layers.shape[-2:]
    taps, weighed = taps_on(projection, stored.device), len({*weights}) > 1
    items = stored.numel() // (views * channels * height * width)
    grid = (blocks(columns, _BLOCK), rows, items * channels)
    errors = layers.new_zeros(grid[::-1]) if every else layers
    _add_up[grid](
        first, first if second is None else second, errors, layers, stored,
        weights_on(tuple(weights), stored.device), *taps[:3], views // taps.together, channels,
        rows, columns, height, width, *shares, 1.0 if weighed else weights[0], every or 1,
        VIEWS=taps.together, LAYERS=number, BEGIN=only or 0,
        END=number if only is None else only + 1, TAPS=taps.top.shape[-1],
        SHOWN=is_product or shares[0] != 0, PRODUCT=is_product, SECOND=second is not None,
        ERROR=every > 0, WEIGHED=weighed, KNOWN=taps.rows, BLOCK=_BLOCK, num_warps=_WARPS,
    )  # fmt: skip
    return errors.view(items, -1).sum(dim=1) if every else errors.new_zeros(items)


@kernel
def _add_up(
    first, second, errors, layers, stored, weights, top, left, weight,
    groups, channels, rows, columns, height, width, of_shown, of_light, common, every,
    VIEWS: tl.constexpr, LAYERS: tl.constexpr, BEGIN: tl.constexpr, END: tl.constexpr,
    TAPS: tl.constexpr, SHOWN: tl.constexpr, PRODUCT: tl.constexpr, SECOND: tl.constexpr,
    ERROR: tl.constexpr, WEIGHED: tl.constexpr, KNOWN: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """A block of a row of one channel of all layers that anything is found for."""
    x = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    y, picture = tl.program_id(1), tl.program_id(2)
    item, channel = picture // channels, picture % channels
    pixels, behind, apart = rows * columns, channels * rows * columns, channels * height * width
    views = stored + (item * groups * VIEWS * channels + channel).to(tl.int64) * height * width
    pixel = layers + (item * LAYERS * channels + channel).to(tl.int64) * pixels + y * columns
    made = (item * (END - BEGIN) * channels + channel).to(tl.int64) * pixels + y * columns + x
    error = tl.zeros([BLOCK], tl.float32)
    for k in tl.static_range(BEGIN, END):
        total, squares = tl.zeros([BLOCK], tl.float32), tl.zeros([BLOCK], tl.float32)
        mine, light = tl.zeros([BLOCK], tl.float32), views
        if SHOWN and TAPS == 1:
            mine = tl.load(pixel + k * behind + x, x < columns, 0.0)
        for group in range(groups):
            for column in tl.static_range(VIEWS):
                i = group * VIEWS + column
                share = tl.load(weights + i) if WEIGHED else 1.0
                for tap in tl.static_range(TAPS):
                    down, across = window_of(
                        top, left, group, column, VIEWS, LAYERS, TAPS, k, tap, KNOWN
                    )
                    slope = share * weight_of(weight, i, LAYERS, TAPS, k, tap)
                    view_x, view_y = x - across, y - down
                    end = tl.where((view_y >= 0) & (view_y < height), width, 0)
                    inside = (view_x >= 0) & (view_x < end)
                    value = tl.load(light + view_y * width - across + x, inside, 0)
                    residual = value.to(tl.float32)
                    if SHOWN:
                        shown, others = _met(
                            pixel + x, behind, columns, inside, mine, top, left, weight, group,
                            column, k, down, across, VIEWS, LAYERS, TAPS, PRODUCT, KNOWN, BLOCK,
                        )  # fmt: skip
                        residual = of_shown * shown + of_light * residual
                        if not PRODUCT or LAYERS == 1:  # of a product nothing is left outside
                            residual = tl.where(inside, residual, 0.0)
                            others = tl.where(inside, others, 0.0)
                        if ERROR and k == BEGIN and tap == 0:
                            error += tl.where(i % every == 0, share, 0.0) * residual * residual
                        residual *= others
                        if SECOND:
                            squares += slope * others * others
                    total += slope * residual
                light += apart
        total *= common if SHOWN else common * of_light
        written = made + (k - BEGIN) * behind
        tl.store(first + written, total, x < columns)
        if SECOND:
            tl.store(second + written, common * squares, x < columns)
    if ERROR:
        block = (picture * rows + y) * tl.num_programs(0) + tl.program_id(0)
        tl.store(errors + block, common * tl.sum(error))


@kernel
def _met(
    pixel, behind, columns, inside, mine, top, left, weight, row, column: tl.constexpr,
    k: tl.constexpr, down, across, VIEWS: tl.constexpr, LAYERS: tl.constexpr, TAPS: tl.constexpr,
    PRODUCT: tl.constexpr, KNOWN: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """What a view shows through the pixels of layer k, and what other layers multiply them by.

    Pixels that are looked at as they are were read before: they are `mine`.
    """
    shown, others = mine, tl.full([BLOCK], 1.0, tl.float32)
    for j in tl.static_range(LAYERS):
        if j != k or TAPS > 1:
            met = tl.zeros([BLOCK], tl.float32)
            for tap in tl.static_range(TAPS):
                below, beside = window_of(
                    top, left, row, column, VIEWS, LAYERS, TAPS, j, tap, KNOWN
                )  # fmt: skip
                moved = (below - down) * columns + beside - across
                value = tl.load(pixel + j * behind + moved, inside, 0.0)
                met += weight_of(weight, row * VIEWS + column, LAYERS, TAPS, j, tap) * value
            if PRODUCT and j != k:
                others *= met
            else:
                shown += met
    return shown * others, others


@kernel
def window_of(
    top, left, row, column: tl.constexpr, VIEWS: tl.constexpr, LAYERS: tl.constexpr,
    TAPS: tl.constexpr, k: tl.constexpr, tap: tl.constexpr, KNOWN: tl.constexpr,
):  # fmt: skip
    """Row and column where a window of a view in layer k begins."""
    if KNOWN is None:
        n = ((row * VIEWS + column) * LAYERS + k) * TAPS + tap
        return tl.load(top + n), tl.load(left + n)
    else:
        return KNOWN[1][k] + row * KNOWN[2][k], KNOWN[0][column * LAYERS + k]


@kernel
def weight_of(
    weight, i, LAYERS: tl.constexpr, TAPS: tl.constexpr, k: tl.constexpr, tap: tl.constexpr
):
    """Weight of that window; whole pixels are looked at as they are."""
    return 1.0 if TAPS == 1 else tl.load(weight + (i * LAYERS + k) * TAPS + tap)


def looked_up(views: KeptViews) -> Num[Tensor, "*batch view c y x"]:
    """Return what kernels read: values where a law says what they are, or else views as stored.

    They are looked up once: at every read that would take longer than all else. Those of codes of
    8 bits are kept in half precision, which has 11.
    """
    if not views.is_whole or views.table is None:
        return views.stored.contiguous()
    if views not in _LOOKED_UP:
        stored, count, block = views.stored.contiguous(), views.stored.numel(), 1024
        dtype = torch.float16 if stored.dtype == torch.uint8 else torch.float32
        result = torch.empty(stored.shape, dtype=dtype, device=stored.device)
        _look_up[blocks(count, block),](result, stored, views.table, count, BLOCK=block)
        _LOOKED_UP[views] = result
    return _LOOKED_UP[views]


@kernel
def _look_up(result, stored, table, count, BLOCK: tl.constexpr):
    n = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    code = tl.load(stored + n, n < count, 0)
    tl.store(result + n, tl.load(table + code.to(tl.int32)), n < count)
