"""Strips of layers around the views: small matrices across them, filters of a few taps along them.

All that becomes of one layer is found by one task.
"""

import math
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


class Sides(NamedTuple):
    """Both directions of a band of views on a grid, which all count alike.

    Args:
        down: of rows below the views.
        across: of columns on their right.
        weight: of every view.
    """

    down: Side
    across: Side
    weight: np.float32


class Strips(NamedTuple):
    """What is added to planes: rows from `top` on and columns from `left` on, around the torus.

    Args:
        below: `[plane, n, tx]`.
        beside: `[plane, ty, n]`.
        top: first row.
        left: first column.
        factor: what to multiply both by.
    """

    below: np.ndarray
    beside: np.ndarray
    top: int
    left: int
    factor: np.float32

    def times(self, factor: float) -> "Strips":
        """Return a multiple."""
        return self._replace(factor=np.float32(self.factor * factor))


_EMPTY = np.zeros((0, 0, 0), np.float32)
NO_STRIPS = Strips(_EMPTY, _EMPTY, 0, 0, np.float32(0))


def strips_of(
    layers: Float[Tensor, "*batch layer c ty tx"], sides: Sides, bounds: tuple[float, float]
) -> Strips:
    """Return the band of layers clamped to bounds.

    With Y along the rows of viewpoints and X along their columns:

        Y^T (1 - M_y) Y  (X^T X - X^T (1 - M_x) X)  +  Y^T Y  X^T (1 - M_x) X

    Args:
        layers: of single precision, on a processor.
        sides: of the band.
        bounds: least and greatest value.
    """
    down, across, weight = sides
    number, channels, height, width = layers.shape[-4:]
    seen = layers.detach().contiguous().view(-1, number, channels, height, width).numpy()
    low, high = np.float32(bounds[0]), np.float32(bounds[1])
    below, beside, columns = room_for_strips(seen.shape, sides)
    count = len(below)
    cut_columns.in_spans(columns, seen, across.start, low, high, count=count, numbers=columns.size)
    numbers = number * down.offset.shape[-1] * (below.size + beside.size)
    given = (below, beside, seen, columns, down, across, low, high)
    fill_strips.in_spans(*given, count=count, numbers=numbers)
    return Strips(below, beside, down.start, across.start, weight)


def room_for_strips(
    shape: tuple[int, ...], sides: Sides
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return arrays for what is below, what is beside, and for columns on the way there.

    Args:
        shape: of layers, `[n, layer, c, ty, tx]`.
        sides: of the band.
    """
    *by, height, width = shape
    thick, wide = sides.down.matrix.shape[-1], sides.across.matrix.shape[-1]
    below = np.empty((math.prod(by), thick, width), np.float32)
    beside = np.empty((math.prod(by), height, wide), np.float32)
    return below, beside, np.empty((*by, wide, height), np.float32)


def add_strips_(result: Float[Tensor, "*batch ty tx"], strips: Strips) -> None:
    """Add strips to contiguous planes, in place."""
    planes = result.view(-1, *result.shape[-2:]).numpy()
    if len(planes) != len(strips.below) or planes.shape[1] != strips.beside.shape[1]:
        raise ValueError(f"found strips of {len(strips.below)} planes, expected {len(planes)}")
    count, numbers = len(planes) * planes.shape[1], strips.below.size + strips.beside.size
    _add_strips.in_spans(planes, strips, count=count, numbers=numbers)


@compiled
def _add_strips(planes, strips, begin, end):
    """Rows of all planes, one after the other, from and to."""
    for place in range(begin, end):
        plane, y = divmod(place, planes.shape[1])
        add_strips_to_row(planes[plane, y], strips, plane, y)


@compiled
def add_strips_to_row(row, strips, plane, y):
    """Add what there is in a row, in place."""
    below, beside, height = strips.below, strips.beside, strips.beside.shape[1]
    for a in range((y - strips.top) % height, below.shape[1], height):
        _add(row, below[plane, a], strips.factor)
    thick = beside.shape[2]
    right = min(thick, len(row) - strips.left)  # what is beyond lies on the left
    for a in range(right):
        row[strips.left + a] += strips.factor * beside[plane, y, a]
    for a in range(right, thick):
        row[a - right] += strips.factor * beside[plane, y, a]


@compiled
def cut_columns(columns, layers, start, low, high, begin, end):
    """Columns of all planes, one after the other, from and to, each as a row."""
    number, channels, height, width = layers.shape[1:]
    thick = columns.shape[3]
    right = min(thick, width - start)
    for place in range(begin, end):
        item, rest = divmod(place, number * channels)
        layer, channel = divmod(rest, channels)
        rows, made = layers[item, layer, channel], columns[item, layer, channel]
        for y in range(height):
            for b in range(right):
                made[b, y] = min(max(rows[y, start + b], low), high)
            for b in range(right, thick):
                made[b, y] = min(max(rows[y, b - right], low), high)


@compiled
def fill_strips(below, beside, layers, columns, down, across, low, high, begin, end):
    """Those of all planes, one after the other, from and to."""
    number, channels = layers.shape[1:3]
    for place in range(begin, end):
        item, rest = divmod(place, number * channels)
        to, channel = divmod(rest, channels)
        _below(below[place], layers[item], channel, to, down, across, low, high)
        _beside(beside[place], columns[item], channel, to, down, across)


@compiled
def _below(result, layers, channel, to, down, across, low, high):
    number, _, height, width = layers.shape
    thick = down.matrix.shape[2]
    row = np.zeros(width, layers.dtype)
    filtered = np.zeros((thick, width), layers.dtype)
    result[:] = 0
    for come in range(number):
        for b in range(thick):
            _clamp(row, layers[come, channel, (down.start + b) % height], low, high)
            _filter(filtered[b], row, across.offset[to, come], across.weight[to, come])
            _leave_out(filtered[b], row, across.matrix[to, come], across.start)
        _mix(result, filtered, down.matrix[to, come])


@compiled
def _beside(result, columns, channel, to, down, across):
    number, _, thick, height = columns.shape
    filtered = np.zeros((thick, height), columns.dtype)
    made = np.zeros((thick, height), columns.dtype)
    for come in range(number):
        for b in range(thick):
            offset, weight = down.offset[to, come], down.weight[to, come]
            _filter(filtered[b], columns[come, channel, b], offset, weight)
        _mix(made, filtered, across.matrix[to, come])
    for y in range(height):
        for a in range(thick):
            result[y, a] = made[a, y]


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
