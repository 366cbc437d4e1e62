"""Sweeps over layers of three colours whose light multiplies, straight from views of 8 bits.

    P_k <- clamp(sum_i w_i A_ik^T o_ik L_i / sum_i w_i A_ik^T o_ik^2)

of one layer after the other, each kernel a layer. Pixels lie with their colours side by side, ten
bits each, in one whole number: every path is followed once for all three, at four bytes a pixel.
Pixels that a sweep makes stay beside it in single precision; what others let through has ten bits,
and so has light that a law makes of codes.
"""

# pyright: reportGeneralTypeIssues=false
# Loops that are unrolled, over `static_range`, are for Triton alone to understand.

from weakref import WeakKeyDictionary

import torch
import triton.language as tl
from jaxtyping import Bool, Float, Int32
from torch import Tensor

from layerfield.kept_views import LARGEST, KeptViews
from layerfield.kernels.gpu.kernel import blocks, kernel
from layerfield.kernels.gpu.light_paths import taps_on, weights_on
from layerfield.kernels.light_paths import LightPaths

_WARPS = 4
_WIDE, _TALL = 64, 4  # pixels of a tile, two a thread
_BLOCK = 1024  # pixels at once, where each is by itself
_UNIT = 1023  # of ten bits
COLOURS = 3
_MOST_LAYERS = 6  # the squared products of more pixels of ten bits are no numbers, summed up
_MOST_UNROLLED = 100  # paths of pairs of layers in a row of views: more are long in compiling
_WORDS = WeakKeyDictionary[KeptViews, Tensor]()  # as long as the views are kept


def serves(paths: LightPaths, bounds: tuple[float, float]) -> bool:
    """Whether views have 8 bits, three colours and a grid of whole pixels, and layers go to 1.

    And there are neither too few layers nor too many for a kernel that knows all paths.
    """
    stored, layers = paths.views.stored, len(paths.projection.taps[0])
    if stored.dtype != torch.uint8 or stored.shape[-3] != COLOURS or bounds != (0.0, 1.0):
        return False
    taps = taps_on(paths.projection, stored.device)
    if taps.rows is None or not 1 < layers <= _MOST_LAYERS:
        return False
    return layers**2 * taps.together <= _MOST_UNROLLED


def swept(
    paths: LightPaths,
    layers: Float[Tensor, "*batch 1 layer c ly lx"],
    last: Float[Tensor, "*batch 1 layer c ly lx"],
    push: Float[Tensor, "*batch 1 1 1 1 1"],
) -> tuple[Float[Tensor, "*batch 1 layer c ly lx"], Bool[Tensor, " item"]]:
    """Return the layers after a sweep, and of every item of a batch whether it went uphill.

    Args:
        paths: which; see `serves`.
        layers: P, contiguous.
        last: P of one sweep ago.
        push: a sweep begins at clamp(P + push (P - P of one sweep ago)).
    """
    projection, views, weights = paths.projection, paths.views, paths.weights
    number, (rows, columns) = layers.shape[-4], layers.shape[-2:]
    height, width = views.stored.shape[-2:]
    taps, weighed = taps_on(projection, layers.device), len({*weights}) > 1
    assert taps.rows is not None
    items = layers.numel() // (number * COLOURS * rows * columns)
    begun = _words_ahead(layers, last, push.contiguous(), items)
    moved, looks = torch.empty_like(layers), words_of(views)
    unit = LARGEST[torch.uint8] if views.table is None else _UNIT
    grid = blocks(columns, _WIDE), blocks(rows, _TALL), items
    products = layers.new_empty(number, *grid[::-1])
    for k in projection.inner_first:
        _move_layer[grid](
            moved, begun, products[k], layers, looks, weights_on(tuple(weights), layers.device),
            _UNIT ** (number - 1) / unit, len(weights) // taps.together, rows, columns, height,
            width, K=k, VIEWS=taps.together, LAYERS=number, KNOWN=taps.rows, WEIGHED=weighed,
            UNIT=_UNIT, WIDE=_WIDE, TALL=_TALL, num_warps=_WARPS,
        )  # fmt: skip
    return moved, products.view(number, items, -1).sum(dim=(0, 2)) > 0


def words_of(views: KeptViews) -> Int32[Tensor, "*batch view y x"]:
    """Return the codes of a pixel's three colours, or the light that a law makes of them."""
    if views not in _WORDS:
        stored, lawful = views.stored.contiguous(), views.table is not None
        *some, _, height, width = stored.shape
        pixels = height * width
        result = torch.empty((*some, height, width), dtype=torch.int32, device=stored.device)
        table = views.table if views.table is not None else stored
        grid = blocks(pixels, _BLOCK), result.numel() // max(pixels, 1)
        _words_of_codes[grid](
            result, stored, table, pixels, LAWFUL=lawful, UNIT=_UNIT, BLOCK=_BLOCK
        )
        _WORDS[views] = result
    return _WORDS[views]


def _words_ahead(layers: Tensor, last: Tensor, push: Tensor, items: int) -> Tensor:
    """Return where a sweep begins."""
    *some, _, rows, columns = layers.shape
    result = torch.empty((*some, rows, columns), dtype=torch.int32, device=layers.device)
    pixels = rows * columns
    planes = result.numel() // max(pixels, 1)
    _words_of_layers[blocks(pixels, _BLOCK), planes](
        result, layers, last, push, planes // max(items, 1), pixels, UNIT=_UNIT, BLOCK=_BLOCK
    )
    return result


@kernel
def _words_of_codes(
    result, stored, table, pixels, LAWFUL: tl.constexpr, UNIT: tl.constexpr, BLOCK: tl.constexpr
):
    n, plane = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK), tl.program_id(1).to(tl.int64)
    code = stored + plane * 3 * pixels + n
    red = tl.load(code, n < pixels, 0).to(tl.int32)
    green = tl.load(code + pixels, n < pixels, 0).to(tl.int32)
    blue = tl.load(code + 2 * pixels, n < pixels, 0).to(tl.int32)
    if LAWFUL:
        red = _whole(tl.load(table + red), UNIT)
        green = _whole(tl.load(table + green), UNIT)
        blue = _whole(tl.load(table + blue), UNIT)
    tl.store(result + plane * pixels + n, red | green << 10 | blue << 20, n < pixels)


@kernel
def _words_of_layers(
    result, layers, last, pushes, planes, pixels, UNIT: tl.constexpr, BLOCK: tl.constexpr
):
    n, plane = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK), tl.program_id(1).to(tl.int64)
    push, there, known = tl.load(pushes + plane // planes), plane * 3 * pixels + n, n < pixels
    word = tl.zeros([BLOCK], tl.int32)
    for colour in tl.static_range(3):
        at = there + colour * pixels
        value = tl.load(layers + at, known, 0.0)
        value += push * (value - tl.load(last + at, known, 0.0))
        word |= _whole(value, UNIT) << (10 * colour)
    tl.store(result + plane * pixels + n, word, known)


@kernel
def _whole(value, UNIT: tl.constexpr):
    """A value from 0 to 1 as a whole number of ten bits."""
    return (tl.minimum(tl.maximum(value, 0.0), 1.0) * UNIT + 0.5).to(tl.int32)


@kernel
def _colours(word):
    """The three whole numbers of a word, as floats.

    Ten bits of a word among the lowest 23 are at once the fraction of a float whose exponent makes
    them whole; what that exponent adds is taken off again. To convert integers takes longer.
    """
    red = _float_of(word & 1023) - 8388608.0
    green = _float_of(word & (1023 << 10)) * (1.0 / 1024) - 8192.0
    return red, green, _float_of(word >> 20) - 8388608.0


@kernel
def _float_of(fraction):
    return (fraction | 0x4B000000).to(tl.float32, bitcast=True)


@kernel
def _move_layer(
    moved, words, products, layers, looks, weights, scale, groups, rows, columns, height, width,
    K: tl.constexpr, VIEWS: tl.constexpr, LAYERS: tl.constexpr, KNOWN: tl.constexpr,
    WEIGHED: tl.constexpr, UNIT: tl.constexpr, WIDE: tl.constexpr, TALL: tl.constexpr,
):  # fmt: skip
    """A tile of one layer of one item, in all colours."""
    n, item = tl.arange(0, WIDE * TALL), tl.program_id(2).to(tl.int64)
    begin_x, begin_y = tl.program_id(0) * WIDE, tl.program_id(1) * TALL
    x, y = begin_x + n % WIDE, begin_y + n // WIDE
    beneath, place, behind = (x < columns) & (y < rows), y * columns + x, rows * columns
    pixels = words + item * LAYERS * behind + place
    views = looks + item * groups * VIEWS * height * width
    # Where all views of all pixels of the tile are inside, as in most, no masks are needed.
    first, last = KNOWN[0][K], KNOWN[0][K]
    for column in tl.static_range(VIEWS):
        first = min(first, KNOWN[0][column * LAYERS + K])
        last = max(last, KNOWN[0][column * LAYERS + K])
    upper, lower = KNOWN[1][K], KNOWN[1][K] + (groups - 1) * KNOWN[2][K]
    inside = (begin_x >= last) & (begin_x + WIDE <= first + width)
    inside &= begin_y >= tl.maximum(upper, lower)
    inside &= begin_y + TALL <= tl.minimum(upper, lower) + height
    if inside:
        sums = _normal_equations(
            pixels, views, weights, x, y, groups, behind, columns, height, width,
            K, VIEWS, LAYERS, KNOWN, WEIGHED, False, WIDE * TALL,
        )  # fmt: skip
    else:
        sums = _normal_equations(
            pixels, views, weights, x, y, groups, behind, columns, height, width,
            K, VIEWS, LAYERS, KNOWN, WEIGHED, True, WIDE * TALL,
        )  # fmt: skip
    begun, word = _colours(tl.load(pixels + K * behind, beneath, 0)), tl.zeros_like(n)
    product = tl.zeros([WIDE * TALL], tl.float32)
    for colour in tl.static_range(3):
        there = (item * LAYERS + K) * 3 * behind + colour * behind + place
        ahead, bent = begun[colour] * (1.0 / UNIT), sums[3 + colour]
        best = tl.where(bent > 0, sums[colour] / tl.maximum(bent, 1e-12) * scale, ahead)
        best = tl.minimum(tl.maximum(best, 0.0), 1.0)
        tl.store(moved + there, best, beneath)
        word |= _whole(best, UNIT) << (10 * colour)
        product += (ahead - best) * (best - tl.load(layers + there, beneath, 0.0))
    tl.store(pixels + K * behind, word, beneath)  # no other pixel of this layer asks for it
    block = (item * tl.num_programs(1) + tl.program_id(1)) * tl.num_programs(0) + tl.program_id(0)
    tl.store(products + block, tl.sum(tl.where(beneath, product, 0.0)))


@kernel
def _normal_equations(
    pixels, looks, weights, x, y, groups, behind, columns, height, width, k: tl.constexpr,
    VIEWS: tl.constexpr, LAYERS: tl.constexpr, KNOWN: tl.constexpr, WEIGHED: tl.constexpr,
    MASKED: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Sums over views of o L and of o^2, each of three colours, of pixels of layer k."""
    light_r, light_g = tl.zeros([BLOCK], tl.float32), tl.zeros([BLOCK], tl.float32)
    light_b, bent_r = tl.zeros([BLOCK], tl.float32), tl.zeros([BLOCK], tl.float32)
    bent_g, bent_b = tl.zeros([BLOCK], tl.float32), tl.zeros([BLOCK], tl.float32)
    for group in range(groups):
        down = KNOWN[1][k] + group * KNOWN[2][k]
        view_y = y - down
        view = looks + group * VIEWS * height * width + view_y * width + x
        for column in tl.static_range(VIEWS):
            across = KNOWN[0][column * LAYERS + k]
            view_x = x - across
            seen = (view_y >= 0) & (view_y < height) & (view_x >= 0) & (view_x < width)
            look = view + (column * height * width - across)
            code = tl.load(look, seen, 0) if MASKED else tl.load(look)
            code_r, code_g, code_b = _colours(code)
            other_r = tl.full([BLOCK], 1.0, tl.float32)
            other_g, other_b = other_r, other_r
            for j in tl.static_range(LAYERS):
                if j != k:
                    row = pixels + (
                        j * behind + (KNOWN[1][j] + group * KNOWN[2][j] - down) * columns
                    )
                    there = row + (KNOWN[0][column * LAYERS + j] - across)
                    met = tl.load(there, seen, 0) if MASKED else tl.load(there)
                    met_r, met_g, met_b = _colours(met)
                    other_r, other_g = other_r * met_r, other_g * met_g
                    other_b *= met_b
            # Outside of a view nothing is met, so that nothing comes of it.
            share_r, share_g, share_b = other_r, other_g, other_b
            if WEIGHED:
                share = tl.load(weights + group * VIEWS + column)
                share_r, share_g, share_b = share * other_r, share * other_g, share * other_b
            light_r += share_r * code_r
            light_g += share_g * code_g
            light_b += share_b * code_b
            bent_r += share_r * other_r
            bent_g += share_g * other_g
            bent_b += share_b * other_b
    return light_r, light_g, light_b, bent_r, bent_g, bent_b
