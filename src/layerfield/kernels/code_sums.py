"""A^T of views as they are stored, for light paths that meet layers at whole pixels.

Codes are summed up as the whole numbers they are: exact, and with twice or four times as many at a
time as floats.
"""

import numpy as np
import torch
from jaxtyping import Float, Num
from torch import Tensor

from layerfield.kernels.compiled import compiled, is_plain


def serve(codes: Tensor) -> bool:
    """Whether `code_sums` can be called: on a processor."""
    return codes.device.type == "cpu" and not is_plain()


def code_sums(
    codes: Num[Tensor, "*batch view c y x"],
    offsets: np.ndarray,
    layer_size: tuple[int, int],
    dtype: torch.dtype,
    unit: float,
) -> Float[Tensor, "*batch layer c ly lx"]:
    """Return the sum over views of codes, each moved as a layer lies beneath it.

    Args:
        codes: whole numbers.
        offsets: `[view, layer, 2]`, row and column of a layer beneath the first pixel of a view.
        layer_size: rows and columns of the layers.
        dtype: whole numbers that hold the sums.
        unit: what code 1 stands for.
    """
    *batch, _, channels, _, _ = codes.shape
    shape = (*batch, offsets.shape[1], channels, *layer_size)
    result = torch.empty(shape, dtype=torch.float32)
    seen = codes.contiguous().view(-1, *codes.shape[-4:]).numpy()
    made, held = result.view(-1, *result.shape[-4:]).numpy(), torch.zeros(1, dtype=dtype).numpy()

    count = len(made) * channels * layer_size[0]
    _add_rows.in_spans(made, seen, offsets, held, unit, count=count, numbers=seen.size)
    return result


@compiled
def _add_rows(layers, views, offsets, held, unit, begin, end):
    """Rows of the layers, all layers together, channel by channel, from and to."""
    number, channels, height, width = layers.shape[1:]
    sums = np.zeros(width, held.dtype)
    for place in range(begin, end):
        item, rest = divmod(place, channels * height)
        channel, row = divmod(rest, height)
        for k in range(number):
            sums[:] = 0
            for i in range(views.shape[1]):
                y, x = row - offsets[i, k, 0], offsets[i, k, 1]
                if 0 <= y < views.shape[3]:
                    _add(sums[x : x + views.shape[4]], views[item, i, channel, y])
            _finish(layers[item, k, channel, row], sums, unit)


@compiled
def _add(sums, codes):
    for x in range(len(codes)):
        sums[x] += codes[x]


@compiled
def _finish(row, sums, unit):
    """In double precision, so that what is exact stays so."""
    for x in range(len(row)):
        row[x] = sums[x] * unit
