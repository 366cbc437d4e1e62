"""A^T of views as they are stored, for light paths that meet layers at whole pixels.

Codes are summed up as the whole numbers they are: exact, and with twice or four times as many at a
time as floats.
"""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Num
from torch import Tensor

from layerfield.kernels.compiled import compiled, is_plain, native


class Paths(NamedTuple):
    """Light paths that end at one layer, those side by side that meet the same columns.

    Args:
        views: `[layer, n]`, where they begin.
        rows: `[layer, n]`, row of the layer beneath the first of a view.
        columns: likewise.
    """

    views: np.ndarray
    rows: np.ndarray
    columns: np.ndarray


def paths_of(offsets: np.ndarray) -> Paths:
    """Return light paths in the order of the columns that they meet.

    Args:
        offsets: `[view, layer, 2]`, row and column of a layer beneath the first pixel of a view.
    """
    rows, columns = offsets.transpose(2, 1, 0)
    views = np.argsort(columns, axis=1, kind="stable")
    in_order = (np.take_along_axis(each, views, axis=1) for each in (rows, columns))
    return Paths(views, *in_order)


def serve(codes: Tensor) -> bool:
    """Whether `code_sums` can be called: on a processor."""
    return codes.device.type == "cpu" and not is_plain()


def code_sums(
    codes: Num[Tensor, "*batch view c y x"],
    paths: Paths,
    layer_size: tuple[int, int],
    dtype: torch.dtype,
    unit: float,
) -> Float[Tensor, "*batch layer c ly lx"]:
    """Return the sum over views of codes, each moved as a layer lies beneath it.

    Args:
        codes: whole numbers.
        paths: see `paths_of`.
        layer_size: rows and columns of the layers.
        dtype: whole numbers that hold the sums.
        unit: what code 1 stands for.
    """
    *batch, _, channels, _, _ = codes.shape
    shape = (*batch, len(paths.views), channels, *layer_size)
    result = torch.empty(shape, dtype=torch.float32)
    seen = codes.contiguous().view(-1, *codes.shape[-4:]).numpy()
    made, held = result.view(-1, *result.shape[-4:]).numpy(), torch.zeros(1, dtype=dtype).numpy()

    units = np.float32(unit), np.float32(unit - float(np.float32(unit)))
    count = len(made) * channels * layer_size[0]
    _add_rows.in_spans(made, seen, paths, held, units, count=count, numbers=seen.size)
    return result


_add_codes = native("layerfield.kernels.code_lanes", "add_codes")
_to_light = native("layerfield.kernels.code_lanes", "to_light")


@compiled
def _add_rows(layers, views, paths, held, units, begin, end):
    """Rows of the layers, all layers together, channel by channel, from and to."""
    number, channels, height, width = layers.shape[1:]
    count, rows, columns = paths.views.shape[1], views.shape[3], views.shape[4]
    sums, found = np.zeros(width, held.dtype), np.empty(count, np.int64)
    own, table, seen = sums.ctypes.data, found.ctypes.data, views.ctypes.data
    for place in range(begin, end):
        item, rest = divmod(place, channels * height)
        channel, row = divmod(rest, height)
        for k in range(number):
            sums[:] = 0
            beside = 0
            for n in range(count):
                i, y, x = paths.views[k, n], row - paths.rows[k, n], paths.columns[k, n]
                if 0 <= y < rows:
                    there = ((item * count + i) * channels + channel) * rows + y
                    found[beside] = seen + there * columns * views.itemsize
                    beside += 1
                if beside > 0 and (n + 1 == count or paths.columns[k, n + 1] != x):
                    _add_codes(sums, views, own + x * sums.itemsize, table, beside, columns)
                    beside = 0
            there = ((item * number + k) * channels + channel) * height + row
            _to_light(sums, layers.ctypes.data + 4 * there * width, own, units[0], units[1], width)
