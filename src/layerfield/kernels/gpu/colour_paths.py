"""Right-hand sides of Newton steps, straight from views whose light of three colours multiplies.

What `light_paths` and `newton_passes.before_` make one after the other. Pixels lie with their
colours side by side: every path is followed once for all three. Layers are kept in half precision
for it, which has 11 bits, but for the pixel that a sum is made for.

A program has a tile of pixels. All of its layers ask the views that look at them: neighbours, which
the tile's other reads have brought into the cache.
"""

# pyright: reportGeneralTypeIssues=false
# Loops that are unrolled, over `static_range`, are for Triton alone to understand.

from weakref import WeakKeyDictionary

import torch
import triton.language as tl
from jaxtyping import Float
from torch import Tensor

from layerfield.kept_views import LARGEST, KeptViews
from layerfield.kernels.gpu.kernel import blocks, kernel
from layerfield.kernels.gpu.light_paths import taps_on, weights_on
from layerfield.kernels.gpu.newton_passes import right_of
from layerfield.kernels.light_paths import LightPaths
from layerfield.kernels.newton_passes import Asked, Before

COLOURS = 3
_WARPS = 4
_WIDE, _TALL = 32, _WARPS  # pixels of a tile, one a thread
_PACKED = 1024  # pixels at once
_MOST_UNROLLED = 100  # paths of pairs of layers in a row of views; 45 are compiled in five seconds
_SIDE_BY_SIDE = WeakKeyDictionary[KeptViews, Tensor]()  # as long as the views are kept


def serves(paths: LightPaths, bounds: tuple[float, float]) -> bool:
    """Whether views have 8 bits, three colours and a grid of whole pixels, and layers go to 1.

    And there are neither too few layers nor too many for a kernel that knows all paths.
    """
    stored, layers = paths.views.stored, len(paths.projection.taps[0])
    if stored.dtype != torch.uint8 or stored.shape[-3] != COLOURS or bounds != (0.0, 1.0):
        return False
    taps = taps_on(paths.projection, stored.device)
    if taps.rows is None or layers == 1:
        return False
    return layers**2 * taps.together <= _MOST_UNROLLED


def right_hand_side(
    paths: LightPaths,
    terms: Before,
    shadow: Float[Tensor, "*batch 1 layer c ly lx"],
    last: Float[Tensor, "*batch 1 layer c ly lx"] | None,
    asked: Asked,
) -> tuple[Tensor, Tensor, Tensor, Float[Tensor, " item"]]:
    """Return what `newton_passes.before` does, and the error of every item of a batch.

    Args:
        paths: which; see `serves`.
        terms: of the right-hand side.
        shadow: s, contiguous.
        last: D of the step before, if there was one.
        asked: the rest.
    """
    projection, views, weights, (torus, every, is_new) = (
        paths.projection, paths.views, paths.weights, asked
    )  # fmt: skip
    *batch, _, layers, channels, rows, columns = shadow.shape
    (ty, tx), (height, width) = torus, views.stored.shape[-2:]
    taps, weighed = taps_on(projection, shadow.device), len({*weights}) > 1
    right = shadow.new_empty(*batch, 1, layers, channels, *torus)
    dual = torch.empty_like(shadow)
    scale = torch.empty_like(shadow) if is_new else last
    assert scale is not None and taps.rows is not None
    items = shadow.numel() // (layers * channels * rows * columns)
    grid = blocks(tx, _WIDE), blocks(ty, _TALL), items
    errors = shadow.new_empty(grid[::-1])
    unit = 1 if views.table is not None else LARGEST[torch.uint8]
    _right_hand_side[grid](
        right, dual, scale, errors, shadow, scale if last is None else last, _packed(shadow),
        side_by_side(views), weights_on(tuple(weights), shadow.device), *terms, float(unit),
        1.0 if weighed else weights[0], len(weights) // taps.together, ty, tx, rows,
        columns, height, width, VIEWS=taps.together, LAYERS=layers, KNOWN=taps.rows, EVERY=every,
        HALF=views.table is not None, WEIGHED=weighed, NEW=is_new, FIRST=last is None,
        WIDE=_WIDE, TALL=_TALL, num_warps=_WARPS,
    )  # fmt: skip
    return right, dual, scale, errors.view(items, -1).sum(dim=1)


def side_by_side(views: KeptViews) -> Tensor:
    """Return the codes of a pixel's three colours as one whole number, or what a law makes of them.

    Of 4 bytes, or of four times half precision; the last is nothing.
    """
    if views not in _SIDE_BY_SIDE:
        stored, looked_up = views.stored.contiguous(), views.table is not None
        *some, _, height, width = stored.shape
        pixels, dtype = height * width, torch.int64 if looked_up else torch.int32
        result = torch.empty((*some, height, width), dtype=dtype, device=stored.device)
        table = views.table if views.table is not None else stored
        grid = blocks(pixels, _PACKED), result.numel() // max(pixels, 1)
        _pack_views[grid](result, stored, table, pixels, LOOKED_UP=looked_up, BLOCK=_PACKED)
        _SIDE_BY_SIDE[views] = result
    return _SIDE_BY_SIDE[views]


def _packed(shadow: Float[Tensor, "*batch 1 layer c ly lx"]) -> Tensor:
    """Return clamp(s), 0 to 1, with the colours of a pixel side by side."""
    *some, _, rows, columns = shadow.shape
    result = torch.empty((*some, rows, columns), dtype=torch.int64, device=shadow.device)
    pixels = rows * columns
    _pack_layers[blocks(pixels, _PACKED), result.numel() // max(pixels, 1)](
        result, shadow, pixels, BLOCK=_PACKED
    )
    return result


@kernel
def _pack_views(result, stored, table, pixels, LOOKED_UP: tl.constexpr, BLOCK: tl.constexpr):
    n, plane = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK), tl.program_id(1).to(tl.int64)
    code = stored + plane * 3 * pixels + n
    red = tl.load(code, n < pixels, 0).to(tl.int32)
    green = tl.load(code + pixels, n < pixels, 0).to(tl.int32)
    blue = tl.load(code + 2 * pixels, n < pixels, 0).to(tl.int32)
    if LOOKED_UP:
        made = _packed_of(tl.load(table + red), tl.load(table + green), tl.load(table + blue))
        tl.store(result + plane * pixels + n, made, n < pixels)
    else:
        tl.store(result + plane * pixels + n, red | green << 8 | blue << 16, n < pixels)


@kernel
def _pack_layers(result, shadow, pixels, BLOCK: tl.constexpr):
    n, plane = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK), tl.program_id(1).to(tl.int64)
    seen = shadow + plane * 3 * pixels + n
    red = tl.load(seen, n < pixels, 0.0)
    green = tl.load(seen + pixels, n < pixels, 0.0)
    blue = tl.load(seen + 2 * pixels, n < pixels, 0.0)
    made = _packed_of(_clamped(red), _clamped(green), _clamped(blue))
    tl.store(result + plane * pixels + n, made, n < pixels)


@kernel
def _clamped(value):
    return tl.minimum(tl.maximum(value, 0.0), 1.0)


@kernel
def _packed_of(red, green, blue):
    """Three values in half precision as one whole number."""
    return _bits(red) | _bits(green) << 16 | _bits(blue) << 32


@kernel
def _bits(value):
    return value.to(tl.float16).to(tl.uint16, bitcast=True).to(tl.int64)


@kernel
def _unpacked(pixel):
    """The three again."""
    low, high = pixel.to(tl.int32), (pixel >> 32).to(tl.int32)
    return _half(low), _half(low >> 16), _half(high)


@kernel
def _half(bits):
    return bits.to(tl.int16).to(tl.float16, bitcast=True).to(tl.float32)


@kernel
def _right_hand_side(
    rights, duals, scales, errors, shadows, lasts, layers, views, weights, rho, trust, low, high,
    weight, least, unit, common, groups, ty, tx, rows, columns, height, width, VIEWS: tl.constexpr,
    LAYERS: tl.constexpr, KNOWN: tl.constexpr, EVERY: tl.constexpr, HALF: tl.constexpr,
    WEIGHED: tl.constexpr, NEW: tl.constexpr, FIRST: tl.constexpr, WIDE: tl.constexpr,
    TALL: tl.constexpr,
):  # fmt: skip
    """A tile of the torus, all layers and colours of one item."""
    n, item = tl.arange(0, WIDE * TALL), tl.program_id(2).to(tl.int64)
    begin_x, begin_y = tl.program_id(0) * WIDE, tl.program_id(1) * TALL
    x, y = begin_x + n % WIDE, begin_y + n // WIDE
    beneath, place, behind = (x < columns) & (y < rows), y * columns + x, rows * columns
    on_torus, of_torus = (x < tx) & (y < ty), y * tx + x
    error = tl.zeros([WIDE * TALL], tl.float32)
    pixels = layers + item * LAYERS * behind + place
    looks = views + item * groups * VIEWS * height * width
    for k in tl.static_range(LAYERS):
        plane = (item * LAYERS + k) * 3
        mine = ()
        for colour in tl.static_range(3):
            mine += (tl.load(shadows + (plane + colour) * behind + place, beneath, 0.0),)
        # Where all views of all pixels of the tile are inside, as in most, no masks are needed.
        first, last = KNOWN[0][k], KNOWN[0][k]
        for column in tl.static_range(VIEWS):
            first = min(first, KNOWN[0][column * LAYERS + k])
            last = max(last, KNOWN[0][column * LAYERS + k])
        upper, lower = KNOWN[1][k], KNOWN[1][k] + (groups - 1) * KNOWN[2][k]
        inside = (begin_x >= last) & (begin_x + WIDE <= first + width)
        inside &= begin_y >= tl.maximum(upper, lower)
        inside &= begin_y + TALL <= tl.minimum(upper, lower) + height
        if inside:
            sums = _paths(
                pixels, looks, weights, x, y, mine, unit, groups, behind, columns, height, width,
                k, VIEWS, LAYERS, KNOWN, EVERY, HALF, WEIGHED, NEW, False, WIDE * TALL,
            )  # fmt: skip
        else:
            sums = _paths(
                pixels, looks, weights, x, y, mine, unit, groups, behind, columns, height, width,
                k, VIEWS, LAYERS, KNOWN, EVERY, HALF, WEIGHED, NEW, True, WIDE * TALL,
            )  # fmt: skip
        error += sums[6]
        for colour in tl.static_range(3):
            slope, bent = common / unit * sums[colour], common * sums[3 + colour]
            there = rights + (plane + colour) * ty * tx + of_torus
            _write(
                there, duals, scales, lasts, (plane + colour) * behind + place, mine[colour], slope,
                bent, beneath, on_torus, rho, trust, low, high, weight, least, NEW, FIRST,
            )  # fmt: skip
    block = (item * tl.num_programs(1) + tl.program_id(1)) * tl.num_programs(0) + tl.program_id(0)
    error = common / (unit * unit) * tl.sum(tl.where(beneath, error, 0.0))
    tl.store(errors + block, error)


@kernel
def _write(
    there, duals, scales, lasts, at, shadow, slope, bent, beneath, on_torus, rho, trust, low, high,
    weight, least, NEW: tl.constexpr, FIRST: tl.constexpr,
):  # fmt: skip
    """What follows from a slope, and from the square of D, of one colour."""
    ago = tl.load(lasts + at, beneath, 1.0)
    scale = ago
    if NEW:
        scale = tl.sqrt(tl.maximum(bent / weight, least))
        tl.store(scales + at, scale, beneath)
    right, dual = right_of(shadow, slope, scale, ago, rho, trust, low, high, FIRST)
    tl.store(duals + at, dual, beneath)
    tl.store(there, tl.where(beneath, right, 0.0), on_torus)


@kernel
def _paths(
    pixels, views, weights, x, y, mine, unit, groups, behind, columns, height, width,
    k: tl.constexpr, VIEWS: tl.constexpr, LAYERS: tl.constexpr, KNOWN: tl.constexpr,
    EVERY: tl.constexpr, HALF: tl.constexpr, WEIGHED: tl.constexpr, NEW: tl.constexpr,
    MASKED: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Sums over views of o (shown - L) and of o^2, each of three colours; and of the error."""
    slope_r, slope_g = tl.zeros([BLOCK], tl.float32), tl.zeros([BLOCK], tl.float32)
    slope_b, error = tl.zeros([BLOCK], tl.float32), tl.zeros([BLOCK], tl.float32)
    bent_r, bent_g = tl.zeros([BLOCK], tl.float32), tl.zeros([BLOCK], tl.float32)
    bent_b = tl.zeros([BLOCK], tl.float32)
    red, green = unit * _clamped(mine[0]), unit * _clamped(mine[1])
    blue, light = unit * _clamped(mine[2]), views
    for group in range(groups):
        down = KNOWN[1][k] + group * KNOWN[2][k]
        view_y = y - down
        for column in tl.static_range(VIEWS):
            i, across, share = group * VIEWS + column, KNOWN[0][column * LAYERS + k], 1.0
            if WEIGHED:
                share = tl.load(weights + i)
            view_x = x - across
            seen = (view_y >= 0) & (view_y < height) & (view_x >= 0) & (view_x < width)
            look = light + (view_y * width + x) - across
            code = tl.load(look, seen, 0) if MASKED else tl.load(look)
            light += height * width
            if HALF:
                light_r, light_g, light_b = _unpacked(code)
            else:
                light_r, light_g = (code & 255).to(tl.float32), ((code >> 8) & 255).to(tl.float32)
                light_b = ((code >> 16) & 255).to(tl.float32)
            other_r = tl.full([BLOCK], 1.0, tl.float32)
            other_g, other_b = other_r, other_r
            for j in tl.static_range(LAYERS):
                if j != k:
                    row = pixels + (
                        j * behind + (KNOWN[1][j] + group * KNOWN[2][j] - down) * columns
                    )
                    there = row + (KNOWN[0][column * LAYERS + j] - across)
                    met = tl.load(there, seen, 0) if MASKED else tl.load(there)
                    met_r, met_g, met_b = _unpacked(met)
                    other_r, other_g = other_r * met_r, other_g * met_g
                    other_b *= met_b
            # Outside of a view nothing is met, so that nothing comes of it.
            off_r, off_g = red * other_r - light_r, green * other_g - light_g
            off_b = blue * other_b - light_b
            if k == 0:
                told = tl.where(i % EVERY == 0, share, 0.0)
                error += told * (off_r * off_r + off_g * off_g + off_b * off_b)
            slope_r += share * other_r * off_r
            slope_g += share * other_g * off_g
            slope_b += share * other_b * off_b
            if NEW:
                bent_r += share * other_r * other_r
                bent_g += share * other_g * other_g
                bent_b += share * other_b * other_b
    return slope_r, slope_g, slope_b, bent_r, bent_g, bent_b, error
