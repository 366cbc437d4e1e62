"""Layer by layer least squares where light multiplies and paths go through whole pixels.

    P_k <- clamp(sum_i w_i A_ik^T o_ik L_i / sum_i w_i A_ik^T o_ik^2)

with o_ik what the other layers let through. What the paths of a pixel bring is gathered there, and
nothing but layers is written. Layers follow each other down the rows, so that what one has made,
and the views, are at hand for the next.
"""

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from layerfield.kept_views import LARGEST, KeptViews
from layerfield.kernels.codes import look_up, looked_up
from layerfield.kernels.compiled import compiled, native, serve
from layerfield.kernels.light_paths import LightPaths
from layerfield.kernels.parts import parts_of, row_at, steps_of
from layerfield.kernels.sweep_passes import extrapolate
from layerfield.links import Multiplicative
from layerfield.projection import Projection

Layers = Float[Tensor, "*batch 1 layer c ly lx"]

LANES = 16  # pixels that stand side by side, at the least
AHEAD = 8  # views, from when what one shows is fetched to when it is its turn
_MOST = 1 << 28  # words of light: half a gigabyte
_LIGHT = WeakKeyDictionary[KeptViews, KeptViews]()  # as long as the views are kept


class _Arrays(NamedTuple):
    """`[n, layer, c, y, x]`: what is made, P, and P of one sweep ago."""

    made: np.ndarray
    layers: np.ndarray
    last: np.ndarray


class _Paths(NamedTuple):
    """`[view, layer]`, where the window of a view begins; and rows that a layer's pixel looks."""

    top: np.ndarray
    left: np.ndarray
    reach: int


class _Limits(NamedTuple):
    """Bounds of pixels, and what views are multiplied by."""

    low: np.float32
    high: np.float32
    unit: np.float32


def serves(paths: LightPaths, layers: Tensor) -> bool:
    """Whether `swept` does: a product, whole pixels, single precision, on a processor."""
    whole = isinstance(paths.link, Multiplicative) and type(paths.projection) is Projection
    return whole and paths.serve(layers) and serve(layers) and paths.projection.is_whole


def swept(
    paths: LightPaths,
    layers: Layers,
    last: Layers,
    push: Float[Tensor, "*batch 1 1 1 1 1"],
    bounds: tuple[float, float],
) -> tuple[Layers, Bool[Tensor, "*batch 1 1 1 1 1"]]:
    """Return layers after a sweep, and whether it went back: (A - P) (P - last P) above 0.

    A = clamp(P + push (P - P of one sweep ago)) is where the sweep begins. Views of no weight are
    not looked at.

    Args:
        paths: from the layers to the views; see `serves`.
        layers: P.
        last: P of one sweep ago.
        push: share of the change.
        bounds: of pixels.

    Raises:
        ValueError: layers of another shape than those of the display and the views.
    """
    number = len(paths.projection.shifts[0])
    for each in (layers, last):
        paths.expect(each, number)
    made = torch.empty(layers.shape, dtype=torch.float32)
    planes = [each.contiguous() for each in (layers, last)]
    arrays = _Arrays(
        *(each.detach().view(-1, *layers.shape[-4:]).numpy() for each in (made, *planes))
    )
    paths = replace(paths, views=_light_of(paths.views))
    known, (items, _, channels, height, _) = _paths(paths.projection), arrays.made.shape
    parts, needs = parts_of(items * channels, height, known.reach, number + 1)
    sums, limits = np.zeros(len(parts)), _Limits(*map(np.float32, (*bounds, 1 / paths.unit)))
    views, each = paths.arrays, (0,) * (number - 1)
    given = each, arrays, sums, views, known, push.flatten().numpy(), parts, limits
    numbers = number * views.stored.size
    _settle_parts.in_spans(*given, count=len(parts), numbers=numbers, needs=needs)
    back = np.bincount(parts[:, 0] // channels, sums, items)
    return made, torch.from_numpy(back > 0).view(push.shape)


def _light_of(views: KeptViews) -> KeptViews:
    """Return views whose codes need not be looked up in every sweep, where there is room for them.

    Light of 16 bits differs from what the law makes of codes by less than 8e-6.
    """
    table, stored = views.table, views.stored
    if table is None or stored.numel() > _MOST or table.min() < 0 or table.max() > 1:
        return views
    if (known := _LIGHT.get(views)) is None:
        words = (table * LARGEST[torch.uint16]).round().to(torch.uint16)
        known = _LIGHT[views] = KeptViews(looked_up(stored, words))
    return known


@lru_cache(maxsize=16)
def _paths(projection: Projection) -> _Paths:
    begins = np.array([[taps[0][:2] for taps in layers] for layers in projection.taps])
    top, left = (np.ascontiguousarray(begins[..., n]) for n in range(2))
    return _Paths(top, left, int(np.ptp(top, axis=1).max()))


_ask_for = native("layerfield.kernels.ahead", "ask_for_bytes")
_settle_paths = native("layerfield.kernels.product_lanes", "settle_paths")


class _Room(NamedTuple):
    """What a thread has for a row: the tables of `settle_paths`, and light beside nothing.

    That is rows as long as those of layers, and `LANES` more: looked up, or as they are stored.
    """

    others: np.ndarray
    light: np.ndarray
    lefts: np.ndarray
    weights: np.ndarray
    looked_up: np.ndarray
    copied: np.ndarray


@compiled
def _settle_parts(each, arrays, uphill, views, paths, pushes, parts, limits, begin, end):
    """Parts from and to, layer by layer behind what they begin with; see `parts_of`."""
    number, channels = arrays.made.shape[1:3]
    count, width = views.stored.shape[1], arrays.made.shape[4] + LANES
    room = _Room(
        np.empty((count, max(1, number - 1)), np.int64),
        np.zeros(count + AHEAD, np.int64),
        np.empty(count, np.int64),
        np.empty(count, np.float32),
        np.zeros((count if len(views.table) > 0 else 0, width), np.float32),
        np.zeros((0 if len(views.table) > 0 else count, width), views.stored.dtype),
    )
    for part in range(begin, end):
        item, channel = divmod(parts[part, 0], channels)
        back = np.float32(0)
        for step in range(*steps_of(parts, part, number + 1, paths.reach)):
            for turn in range(number + 1):
                y = row_at(parts, part, turn, step, paths.reach)
                if y >= 0 and turn == 0:
                    _begin_rows(arrays, (item, channel, y), pushes[item], limits)
                elif y >= 0:
                    place = item, turn - 1, channel, y
                    back += _settle_row(each, arrays, views, paths, room, place, limits)
        uphill[part] = back


@compiled
def _begin_rows(arrays, place, push, limits):
    """Write where the sweep begins into a row of every layer."""
    item, channel, y = place
    for k in range(arrays.made.shape[1]):
        row, ago = arrays.layers[item, k, channel, y], arrays.last[item, k, channel, y]
        extrapolate(arrays.made[item, k, channel, y], row, ago, push, limits)


@compiled
def _settle_row(each, arrays, views, paths, room, place, limits):
    """Settle a row of a layer, and return how far that led back."""
    (item, k, channel, y), made = place, arrays.made
    above = item * made.strides[0] + channel * made.strides[2]
    here = above + k * made.strides[1] + y * made.strides[3]
    level = made.ctypes.data + above
    seen, first, last = _find_paths(made, views, paths, room, place, level)
    rows = made.ctypes.data + here, arrays.layers.ctypes.data + here
    tables = (
        room.others.ctypes.data,
        room.light.ctypes.data,
        room.lefts.ctypes.data,
        room.weights.ctypes.data,
    )
    span = made.shape[4], first, last, views.stored.shape[4]
    known = limits.low, limits.high, limits.unit
    if len(views.table) > 0:
        return _settle_paths(each, room.looked_up, rows, tables, seen, span, known)
    return _settle_paths(each, views.stored, rows, tables, seen, span, known)


@compiled
def _find_paths(made, views, paths, room, place, level):
    """Fill the tables of a row; return how many views look at it, and from where to where all do.

    Row 0 of layer 0 is at `level`.
    """
    item, k, channel, y = place
    _, layer_size, _, row_size, size = made.strides
    height, columns = views.stored.shape[3:]
    seen, first, last = 0, 0, made.shape[4]
    for i in range(len(views.weights)):
        row, left, n = y - paths.top[i, k], paths.left[i, k], 0
        if row < 0 or row >= height or views.weights[i] == 0:
            continue
        for j in range(made.shape[1]):
            if j != k:
                there = (row + paths.top[i, j]) * row_size + (paths.left[i, j] - left) * size
                room.others[seen, n] = level + j * layer_size + there
                n += 1
        room.light[seen] = _light_at(views, room, (item, i, channel, row), left, seen)
        room.lefts[seen], room.weights[seen] = left, views.weights[i]
        first, last = max(first, left), min(last, left + columns)
        seen += 1
    return seen, first, max(first, last)


@compiled
def _light_at(views, room, place, left, seen):
    """Return where what a row of a view shows at pixel 0 of the layer's row would be.

    Rows are read past their ends, see `settle_paths`: the first and last of all views are copied.
    The next row of the view is fetched meanwhile.
    """
    (item, i, channel, row), codes = place, views.stored
    if len(views.table) > 0:
        light = room.looked_up[seen]
        look_up(light[left : left + codes.shape[4]], codes[item, i, channel, row], views.table)
        return light.ctypes.data
    steps = item * codes.strides[0] + i * codes.strides[1] + channel * codes.strides[2]
    steps += row * codes.strides[3] - left * codes.strides[4]
    if steps < 0 or steps + room.copied.shape[1] * codes.strides[4] > codes.nbytes:
        light = room.copied[seen]
        light[left : left + codes.shape[4]] = codes[item, i, channel, row]
        return light.ctypes.data
    there = codes.ctypes.data + steps
    _ask_for(there + codes.strides[3] + left * codes.strides[4], codes.strides[3])
    return there
