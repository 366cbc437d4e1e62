"""A^T of views as they are stored, for light paths that meet layers at whole pixels.

Codes are summed up as the whole numbers they are: exact, and with twice or four times as many at a
time as floats.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Num
from torch import Tensor

from layerfield.kernels.compiled import compiled, is_plain, native

SUMMED = 32  # codes of a row, at the least, that are added up at once


class Paths(NamedTuple):
    """Light paths that end at one layer, those side by side that meet the same columns.

    Args:
        views: `[layer, n]`, where they begin.
        rows: `[layer, n]`, row of the layer beneath the first of a view.
        columns: likewise.
        first: `[view]`, the least of the rows.
    """

    views: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    first: np.ndarray


def paths_of(offsets: np.ndarray) -> Paths:
    """Return light paths in the order of the columns that they meet.

    Args:
        offsets: `[view, layer, 2]`, row and column of a layer beneath the first pixel of a view.
    """
    rows, columns = offsets.transpose(2, 1, 0)
    views = np.argsort(columns, axis=1, kind="stable")
    in_order = [np.take_along_axis(each, views, axis=1) for each in (rows, columns)]
    return Paths(views, in_order[0], in_order[1], rows.min(axis=0))


def serve(codes: Tensor) -> bool:
    """Whether `code_sums` can be called: on a processor."""
    return codes.device.type == "cpu" and not is_plain()


class Codes(NamedTuple):
    """Codes of views, and how they are added up on layers.

    Args:
        views: `[*batch, view, c, y, x]`, whole numbers.
        paths: see `paths_of`.
        layer_size: rows and columns of the layers.
        dtype: whole numbers that hold the sums.
        unit: what code 1 stands for.
    """

    views: Tensor
    paths: Paths
    layer_size: tuple[int, int]
    dtype: torch.dtype
    unit: float

    def none(self, width: int, dtype: torch.dtype) -> Num[Tensor, "*batch layer c ly width"]:
        """Return memory for what is made of the sums, in rows of a width."""
        *batch, _, channels, _, _ = self.views.shape
        shape = *batch, len(self.paths.views), channels, self.layer_size[0], width
        return torch.empty(shape, dtype=dtype)

    def add_(self, loop: Callable[..., None], made: Tensor, *more: Any) -> None:
        """Have a compiled loop write rows of what is made, all layers of a row at a time."""
        to = made.view(-1, *made.shape[-4:]).numpy()
        seen = self.views.contiguous().view(-1, *self.views.shape[-4:]).numpy()
        held = torch.zeros(1, dtype=self.dtype).numpy()
        units = np.float32(self.unit), np.float32(self.unit - float(np.float32(self.unit)))
        count = len(to) * to.shape[2] * to.shape[3]
        loop(to, seen, self.paths, held, units, *more, count=count, numbers=seen.size)


def code_sums(codes: Codes) -> Float[Tensor, "*batch layer c ly lx"]:
    """Return the sum over views of codes, each moved as a layer lies beneath it."""
    made = codes.none(codes.layer_size[1], torch.float32)
    codes.add_(_add_rows.in_spans, made)
    return made


_add_codes = native("layerfield.kernels.code_lanes", "add_codes")
_sum_codes = native("layerfield.kernels.code_lanes", "sum_codes")
_to_light = native("layerfield.kernels.code_lanes", "to_light")


@compiled
def _add_rows(layers, views, paths, held, units, begin, end):
    """Rows of the layers, all layers together, channel by channel, from and to."""
    number, channels, height, width = layers.shape[1:]
    sums, found = room_for_rows(paths, width, held)
    for place in range(begin, end):
        item, rest = divmod(place, channels * height)
        channel, row = divmod(rest, height)
        for k in range(number):
            sum_row(sums, found, views, paths, (item, channel, k, row))
            there = ((item * number + k) * channels + channel) * height + row
            to, own = layers.ctypes.data + 4 * there * width, sums.ctypes.data
            _to_light(sums, to, own, units[0], units[1], width)


@compiled
def room_for_rows(paths, width, held):
    """Return what `sum_row` writes sums and addresses on."""
    return np.empty(width, held.dtype), np.empty((2, paths.views.shape[1]), np.int64)


@compiled
def sum_row(sums, found, views, paths, place):
    """Add up the codes that meet a row of a layer, given item, channel, layer and row.

    What all paths meet is added up at once, ends that some do not meet one by one. Meanwhile rows
    are fetched that the next but one row of layers is the first to look at, and every layer has as
    many of them fetched: memory is waited for where it is asked for much at once. Those of each
    view lie far apart: no processor foresees so many.

    Args:
        sums: that are written, whatever was there.
        found: room for addresses of rows of codes, moved as they meet it, and of those to come.
        views: `[item, view, c, y, x]`, codes.
        paths: see `Paths`.
        place: item, channel, layer and row.
    """
    item, channel, k, row = place
    layers, (count, channels, rows, columns) = len(paths.views), views.shape[1:]
    left, right = paths.columns[k, count - 1], paths.columns[k, 0] + columns
    is_wide = right - left >= SUMMED
    for x in range(left if is_wide else len(sums)):
        sums[x] = 0
    for x in range(right if is_wide else len(sums), len(sums)):
        sums[x] = 0
    size, apart, number, beside = columns * views.itemsize, channels * rows, 0, 0
    first = views.ctypes.data + (item * count * channels + channel) * rows * size
    own, table = sums.ctypes.data, found.ctypes.data
    for n in range(count):
        i, y, x = paths.views[k, n], row - paths.rows[k, n], paths.columns[k, n]
        if 0 <= y < rows:
            here = first + (i * apart + y) * size - x * views.itemsize
            later = first + (i * apart + row + 2 - paths.first[i]) * size
            found[0, number], found[1, number] = here, later if i % layers == k else here
            number += 1
        if number > beside and (n + 1 == count or paths.columns[k, n + 1] != x):
            rest, some = table + 8 * beside, number - beside
            if is_wide:
                _add_codes(sums, views, own, rest, some, (x, left - x))
                _add_codes(sums, views, own, rest, some, (right, x + columns - right))
            else:
                _add_codes(sums, views, own, rest, some, (x, columns))
            beside = number
    if is_wide:
        both = table, table + 8 * count
        _sum_codes(sums, views, own, both, number, (left, right - left))
