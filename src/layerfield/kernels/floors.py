"""The least that pixels of half size may be, in 16-bit words, for layers of whole size.

    least = max(e - (least of e - least, of 4x4 pixels of whole size around it), 0)

with e the balanced start: see `floor_of` of `half_size`. Each row of whole size is looked at once.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import UInt16
from torch import Tensor

from layerfield.kernels.compiled import compiled, native
from layerfield.kernels.words import WORDS, Words

FAR = 2**15 - 1  # no word falls so far
PARTS = 2**12  # what a unit is told in


class Seen(NamedTuple):
    """What is known of layers of one size, in words.

    Args:
        words: the normal equations.
        light: b.
        floor: the least that pixels may be, if anything but 0.
    """

    words: Words
    light: UInt16[Tensor, "*batch 1 layer c y words"]
    floor: UInt16[Tensor, "*batch 1 layer c y words"] | None = None


def floor_words(
    whole: Seen, half: Seen, before: tuple[int, int]
) -> UInt16[Tensor, "*batch 1 layer c hy words"]:
    """Return the least that pixels of half size may be; 0 where no view sees them.

    Args:
        whole: what is known of layers of whole size.
        half: of those of half size, as far as the others and no less.
        before: pixels (y, x) of whole size by which they begin before the others, 0 or 1.
    """
    made = torch.empty_like(half.light)
    floor = whole.light[:0] if whole.floor is None else whole.floor
    given = made, half.light, whole.light, floor
    planes = _Planes(*(each.contiguous().view(-1, *each.shape[-4:]).numpy() for each in given))
    unit = round(PARTS * half.words.most / whole.words.most)
    tables = whole.words.even, whole.words.row_counts, half.words.even, half.words.row_counts
    count = math.prod(half.light.shape[:-1])
    _find_floors.in_spans(planes, tables, before, unit, count=count, numbers=whole.light.numel())
    return made


class _Planes(NamedTuple):
    """`[item, layer, c, y, word]`: what is made, b of half size, b, and least of whole size."""

    made: np.ndarray
    small: np.ndarray
    seen: np.ndarray
    floor: np.ndarray


_lessen = native("layerfield.kernels.floor_lanes", "lessen")
_write_floor = native("layerfield.kernels.floor_lanes", "write_floor")


@compiled
def _find_floors(planes, tables, before, unit, begin, end):
    """Rows of all planes of half size, one after the other, from and to."""
    number, channels, rows, width = planes.made.shape[1:]
    _, _, even, row_counts = tables
    length = max(2 * width, planes.seen.shape[4]) + 2 * WORDS
    falls, none = np.empty((2, length), np.uint16), np.zeros(planes.seen.shape[4], np.uint16)
    above, below, last = 0, 1, -1
    for n in range(begin, end):
        plane, y = divmod(n, rows)
        layer, first = plane // channels % number, 2 * y - before[0] - 1
        if last != n - 1 or y == 0:
            _fall(falls[above], none, planes, tables, (plane, layer), first, before[1])
        _fall(falls[below], none, planes, tables, (plane, layer), first + 2, before[1])
        size = 2 * n * width
        shares = even.ctypes.data + 2 * (row_counts[layer, y] * number + layer) * width
        both = falls.ctypes.data, falls.ctypes.data + 2 * length
        here = planes.small.ctypes.data + size, shares
        _write_floor(planes.made.ctypes.data + size, here, both, unit, width)
        above, below, last = below, above, n


@compiled
def _fall(to, none, planes, tables, place, first, beside):
    """Write how far words of two rows may fall, the lesser of both, behind as many and one more."""
    (plane, layer), (height, width) = place, planes.seen.shape[3:]
    even, row_counts, _, _ = tables
    number = even.shape[1]
    for x in range(len(to)):
        to[x] = FAR
    for y in range(max(first, 0), min(first + 2, height)):
        here = 2 * (plane * height + y) * width
        floor = none.ctypes.data + 0  # of the kind that sums are
        if planes.floor.size > 0:
            floor = planes.floor.ctypes.data + here
        shares = even.ctypes.data + 2 * (row_counts[layer, y] * number + layer) * width
        rows = planes.seen.ctypes.data + here, shares, floor
        _lessen(to.ctypes.data + 2 * (beside + 1), rows, width)
