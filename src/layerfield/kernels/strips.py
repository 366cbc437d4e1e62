"""Strips of layers around the views: small matrices across them, filters of a few taps along them.

All that becomes of one layer is found by one task, from the layers as they lie in memory.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.compiled import compiled


class Side(NamedTuple):
    """One direction of a band of views on a grid.

    Args:
        start: first layer pixel of the strip; it may run on past the end of the torus.
        matrix: `[to layer, from layer, n, n]`, across the strip: Y^T (1 - M) Y.
        offset: `[to layer, from layer, tap]`, pixels around a circle, and
        weight: those of Y^T Y; unused ones are 0.
    """

    start: int
    matrix: np.ndarray
    offset: np.ndarray
    weight: np.ndarray


def add_band_(
    result: Float[Tensor, "*batch layer c ty tx"],
    layers: Float[Tensor, "*batch layer c ty tx"],
    sides: tuple[Side, Side],
    factor: float,
    bounds: tuple[float, float],
) -> None:
    """Add a multiple of the band of layers clamped to bounds, in place.

    With Y along the rows of viewpoints and X along their columns:

        Y^T (1 - M_y) Y  (X^T X - X^T (1 - M_x) X)  +  Y^T Y  X^T (1 - M_x) X

    Args:
        result: contiguous.
        layers: of the same shape.
        sides: of rows below the views, and of columns on their right.
        factor: multiple.
        bounds: least and greatest value.
    """
    if layers.shape != result.shape:
        raise ValueError(f"found layers {tuple(layers.shape)}, expected {tuple(result.shape)}")
    by = result.shape[-4:]
    made, seen = result.view(-1, *by).numpy(), layers.detach().contiguous().view(-1, *by).numpy()
    (down, across), share = sides, np.float32(factor)
    low, high = np.float32(bounds[0]), np.float32(bounds[1])
    number, channels, height, width = by
    pixels = down.matrix.shape[-1] * width + across.matrix.shape[-1] * height
    count = len(made) * channels * number
    numbers = count * number * down.offset.shape[-1] * pixels
    _add_band.in_spans(made, seen, down, across, share, low, high, count=count, numbers=numbers)


@compiled
def _add_band(result, layers, down, across, factor, low, high, begin, end):
    """Layers of all colours, one after the other, from and to."""
    number, channels = layers.shape[1:3]
    for place in range(begin, end):
        item, rest = divmod(place, channels * number)
        channel, to = divmod(rest, number)
        planes, made = layers[item, :, channel], result[item, to, channel]
        _add_below(made, planes, to, down, across, factor, low, high)
        _add_beside(made, planes, to, down, across, factor, low, high)


@compiled
def _add_below(result, planes, to, down, across, factor, low, high):
    number, height, width = planes.shape
    thick = down.matrix.shape[2]
    row = np.zeros(width, planes.dtype)
    filtered = np.zeros((thick, width), planes.dtype)
    made = np.zeros((thick, width), planes.dtype)
    for come in range(number):
        for b in range(thick):
            _clamp(row, planes[come, (down.start + b) % height], low, high)
            _filter(filtered[b], row, across.offset[to, come], across.weight[to, come])
            _leave_out(filtered[b], row, across.matrix[to, come], across.start)
        _mix(made, filtered, down.matrix[to, come])
    for a in range(thick):
        _add(result[(down.start + a) % height], made[a], factor)


@compiled
def _add_beside(result, planes, to, down, across, factor, low, high):
    number, height, width = planes.shape
    thick = across.matrix.shape[2]
    right = min(thick, width - across.start)  # what is beyond lies on the left
    columns = np.zeros((thick, height), planes.dtype)
    filtered = np.zeros((thick, height), planes.dtype)
    made = np.zeros((thick, height), planes.dtype)
    for come in range(number):
        for y in range(height):
            for b in range(right):
                columns[b, y] = planes[come, y, across.start + b]
            for b in range(right, thick):
                columns[b, y] = planes[come, y, b - right]
        for b in range(thick):
            _clamp(columns[b], columns[b], low, high)
            _filter(filtered[b], columns[b], down.offset[to, come], down.weight[to, come])
        _mix(made, filtered, across.matrix[to, come])
    for y in range(height):
        for a in range(right):
            result[y, across.start + a] += factor * made[a, y]
        for a in range(right, thick):
            result[y, a - right] += factor * made[a, y]


@compiled
def _clamp(row, other, low, high):
    for x in range(len(row)):
        row[x] = min(max(other[x], low), high)


@compiled
def _filter(result, row, offset, weight):
    length = len(row)
    for tap in range(len(offset)):
        turn = offset[tap] % length
        if tap == 0:
            _set(result[: length - turn], row[turn:], weight[tap])
            _set(result[length - turn :], row[:turn], weight[tap])
        elif weight[tap] != 0:
            _add(result[: length - turn], row[turn:], weight[tap])
            _add(result[length - turn :], row[:turn], weight[tap])


@compiled
def _leave_out(result, row, matrix, start):
    """Without what columns on the right of the views show."""
    for a in range(len(matrix)):
        for b in range(len(matrix)):
            if matrix[a, b] != 0:  # few are: views join pixels a few apart
                result[(start + a) % len(row)] -= matrix[a, b] * row[(start + b) % len(row)]


@compiled
def _mix(result, rows, matrix):
    for a in range(len(matrix)):
        for b in range(len(matrix)):
            if matrix[a, b] != 0:
                _add(result[a], rows[b], matrix[a, b])


@compiled
def _set(row, other, weight):
    for x in range(len(row)):
        row[x] = weight * other[x]


@compiled
def _add(row, other, weight):
    for x in range(len(row)):
        row[x] += weight * other[x]
