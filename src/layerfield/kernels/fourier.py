"""Fourier transforms of complex planes, compiled: for processors that MKL computes slowly on.

Eight transforms are made side by side, in vectors of eight: of eight rows, which are turned to
columns for that, then of eight columns. Each is one of a few radices after the other, and no digits
have to be reversed, as Stockham found: with n = r m, s transforms of length n in turns, and
e(t) = exp(-2 pi i t),

    y[q + s (r p + k)] = e(p k / n) sum_j x[q + s (p + m j)] e(j k / r),  p < m,  q < s,

leaves s r transforms of length m. Between rows and columns, real and imaginary parts
of eight numbers stay apart, in their own place in the plane. Back from frequencies to pixels, real
and imaginary parts change places on the way in and out.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Complex
from torch import Tensor

from layerfield.kernels.compiled import compiled, native
from layerfield.kernels.radices import LANES, radices_of

_GROUP = 2 * LANES
_HEAD, _MOST = 6, 64  # whole numbers at the beginning of a packed plan; radices of a length


class _Plan(NamedTuple):
    """Of planes of one size.

    Args:
        across: radices of rows.
        down: of columns.
        turns_across: cos and sin of 2 pi t / n of rows.
        turns_down: of columns.
        by_row: whether rows alone are transformed.
        back: from frequencies to pixels.
    """

    across: np.ndarray
    down: np.ndarray
    turns_across: np.ndarray
    turns_down: np.ndarray
    by_row: bool
    back: bool


class FourierTransform:
    """Transforms planes of one size in place, without any factor.

    Args:
        height: of the planes.
        width: in complex numbers.
        by_row: every row by itself, or both directions.
        back: from frequencies to pixels.
    """

    def __init__(self, height: int, width: int, by_row: bool, back: bool) -> None:
        across, down = radices_of(width), radices_of(1 if by_row else height)
        assert across is not None
        assert down is not None
        turns = turns_of_length(width), turns_of_length(1 if by_row else height)
        self._plan = _Plan(across, down, *turns, by_row, back)
        head = [height, width, len(across), len(down), int(by_row), int(back)]
        parts = np.array(head, np.int64), across, down, *turns
        self._packed = np.concatenate([each.view(np.int64) for each in parts])

    is_for_one_thread = True  # columns of huge planes, too, pass through the cache

    @property
    def address(self) -> int:
        """Where `long (*)(void *handle, void *plane)` is, which transforms one."""
        return _transform_at.address

    @property
    def handle(self) -> int:
        """What it is called with, as long as this lives."""
        return self._packed.ctypes.data

    def __call__(self, planes: Complex[Tensor, "plane y x"]) -> None:
        """Transform contiguous planes by all threads together."""
        made = torch.view_as_real(planes).flatten(-2).numpy()
        count, height, width = made.shape
        rows, columns = (math.ceil(each / LANES) for each in (height, width // 2))
        _transform_rows.in_spans(made, self._plan, count=count * rows, numbers=made.size)
        if not self._plan.by_row:
            _transform_columns.in_spans(made, self._plan, count=count * columns, numbers=made.size)


@lru_cache(maxsize=64)
def plane_transform_of(
    height: int, width: int, by_row: bool, back: bool
) -> FourierTransform | None:
    """Return what transforms planes of a size; None of lengths with prime factors above 13."""
    if radices_of(width) is None or (not by_row and radices_of(height) is None):
        return None
    return FourierTransform(height, width, by_row, back)


def turns_of_length(length: int) -> np.ndarray:
    """Return cos and sin of 2 pi t / n, side by side."""
    angle = np.arange(length) * (2 * np.pi / length)
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1).astype(np.float32).ravel()


_butterflies = native("layerfield.kernels.lanes", "butterflies")
_take_rows = native("layerfield.kernels.lanes", "take_rows")
_put_rows = native("layerfield.kernels.lanes", "put_rows")
_put_group = native("layerfield.kernels.lanes", "put_group")
_array_at = native("numba", "carray")


@compiled
def _transform_at(handle, data):
    """`long (*)(void *handle, void *plane)`."""
    head = _array_at(handle, (_HEAD,), np.int64)
    height, width, across, down = head[0], head[1], head[2], head[3]
    turns = width, height if head[4] == 0 else 1
    packed = _array_at(handle, (_HEAD + across + down + turns[0] + turns[1],), np.int64)
    angles = packed[_HEAD + across + down :].view(np.float32)
    radices = packed[_HEAD : _HEAD + across], packed[_HEAD + across : _HEAD + across + down]
    plan = _Plan(
        radices[0], radices[1], angles[: 2 * width], angles[2 * width :], head[4] != 0, head[5] != 0
    )
    planes = _array_at(data, (1, height, 2 * width), np.float32)
    _transform_rows(planes, plan, 0, (height + LANES - 1) // LANES)
    if not plan.by_row:
        _transform_columns(planes, plan, 0, (width + LANES - 1) // LANES)
    return 0


@compiled
def _transform_rows(planes, plan, begin, end):
    """Eight rows at a time, from and to: of all planes, one after the other.

    Rows before the end of a plane, and rows that do not fill groups, are copied to where they do.
    """
    height, width = planes.shape[1], planes.shape[2] // 2
    groups, tiles = (width + LANES - 1) // LANES, (height + LANES - 1) // LANES
    pitch, wide = planes.shape[2], groups * _GROUP
    aside = np.zeros((LANES, wide), np.float32)
    one, other = np.empty(LANES * wide, np.float32), np.empty(LANES * wide, np.float32)
    for number in range(begin, end):
        plane, tile = divmod(number, tiles)
        top = tile * LANES
        rows = min(LANES, height - top)
        is_whole = rows == LANES and width % LANES == 0
        if is_whole:
            there, step, first = planes[plane].reshape(-1), pitch, top * pitch
        else:
            for y in range(rows):
                _copy(aside[y], planes[plane, top + y])
            there, step, first = aside.reshape(-1), wide, 0
        for group in range(groups):
            place = group * LANES * _GROUP
            _take_rows(there, first + group * _GROUP, step, one, place, plan.back)
        is_in_one = transform_groups(
            plan.across, width, one, 0, _GROUP, other, one, plan.turns_across
        )
        made = one if is_in_one else other
        for group in range(groups):
            place, apart = group * LANES * _GROUP, not plan.by_row and (group + 1) * LANES <= width
            swapped = plan.back and plan.by_row
            _put_rows(made, place, there, first + group * _GROUP, step, swapped, apart)
        if not is_whole:
            for y in range(rows):
                _copy(planes[plane, top + y], aside[y])


@compiled
def _transform_columns(planes, plan, begin, end):
    """Eight columns at a time, from and to: of all planes, one after the other.

    Behind the last groups that are full there may be numbers of a few columns, side by side.
    """
    height, width = planes.shape[1], planes.shape[2] // 2
    tiles, pitch = (width + LANES - 1) // LANES, planes.shape[2]
    aside = np.zeros(height * _GROUP, np.float32)
    one, other = np.empty(height * _GROUP, np.float32), np.empty(height * _GROUP, np.float32)
    for number in range(begin, end):
        plane, tile = divmod(number, tiles)
        there, first = planes[plane].reshape(-1), tile * _GROUP
        columns = min(LANES, width - tile * LANES)
        if columns == LANES:
            seen, begun, step = there, first, pitch
        else:
            for y in range(height):
                for x in range(columns):
                    aside[y * _GROUP + x] = there[y * pitch + first + 2 * x]
                    aside[y * _GROUP + LANES + x] = there[y * pitch + first + 2 * x + 1]
            seen, begun, step = aside, 0, _GROUP
        is_in_one = transform_groups(
            plan.down, height, seen, begun, step, other, one, plan.turns_down
        )
        made = one if is_in_one else other
        for y in range(height):
            if columns == LANES:
                _put_group(made, y * _GROUP, there, y * pitch + first, plan.back)
            else:
                _put_group(made, y * _GROUP, aside, 0, plan.back)
                for x in range(2 * columns):
                    there[y * pitch + first + x] = aside[x]


@compiled
def transform_groups(radices, length, seen, begin, step, other, one, turns):
    """Transform lane groups; return whether what was made is in `one`, or else in `other`.

    Args:
        radices: their product is the length.
        length: how many groups.
        seen: where they are; may be `one`.
        begin: where the first of them is.
        step: from one to the next.
        other: filled first.
        one: filled next.
        turns: cos and sin of 2 pi t / length.
    """
    radix = radices[0]
    m = length // radix
    for p in range(m):
        place = radix * p * _GROUP
        given = begin + p * step
        _butterflies(radix, seen, given, m * step, other, place, _GROUP, 1, turns, p)
    s, is_in_one = radix, False
    for number in range(1, len(radices)):
        radix = radices[number]
        m //= radix
        here, there = (one, other) if is_in_one else (other, one)
        for p in range(m):
            given, place = s * p * _GROUP, s * radix * p * _GROUP
            stride = s * _GROUP
            _butterflies(radix, here, given, m * stride, there, place, stride, s, turns, s * p)
        s, is_in_one = s * radix, not is_in_one
    return is_in_one


@compiled
def _copy(row, other):
    """The beginning, of rows of other lengths."""
    for x in range(min(len(row), len(other))):
        row[x] = other[x]
