"""Layers of half size brought to whole size in 16-bit words, where light adds up.

    P = e + up(Q - e of half size),  with e the balanced start

Row by row, right before sweeps look at them. What is in brackets is known once, as numbers finer
than words by a few bits; up is linear interpolation of those.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt16
from torch import Tensor

from layerfield.kernels.compiled import compiled, native
from layerfield.kernels.words import WORDS, Words

_LARGEST = 2**13 - 1  # of numbers with a sign, sums of four of which are words


class Enlargement(NamedTuple):
    """What words of whole size begin as, for compiled loops; see `enlargement_of`.

    Args:
        change: `[plane, hy, more]`, Q - e of half size; beyond the last column what was in memory.
        columns: how many it has.
        bits: of a change that stand behind the point of a word.
        rest: `[item, channel]`, words of pixels that nobody sees.
        before: pixels of whole size by which those of half size begin before the others.
    """

    change: np.ndarray
    columns: int
    bits: int
    rest: np.ndarray
    before: tuple[int, int]


NOT_ENLARGED = Enlargement(np.zeros((0, 0, 0), np.int16), 0, 0, np.zeros((0, 0), np.int64), (0, 0))


class HalfWords(NamedTuple):
    """What is known at half size, in words.

    Args:
        words: the normal equations.
        found: Q.
        seen: b.
    """

    words: Words
    found: UInt16[Tensor, "*batch 1 layer c hy words"]
    seen: UInt16[Tensor, "*batch 1 layer c hy words"]


def enlargement_of(
    words: Words, half: HalfWords, rest: Float[np.ndarray, "item c"], before: tuple[int, int]
) -> Enlargement:
    """Return what brings layers of half size to whole size.

    Args:
        words: the normal equations of whole size.
        half: what is known at half size: as far as layers of whole size and no less; it goes on at
            its edges.
        rest: light of pixels that nobody sees.
        before: see `Enlargement`.
    """
    small = half.words
    columns = small.shares.shape[1]
    found, seen = (
        each.contiguous().view(-1, *each.shape[-4:]).numpy() for each in (half.found, half.seen)
    )
    change = np.empty((*found.shape[:-1], -(-columns // WORDS) * WORDS), np.int16)
    bits = int(np.log2(_LARGEST // words.most))
    unit, own = (
        np.float32((words.most << bits) / small.most),
        (rest * small.most).astype(np.float32),
    )
    given = change, found, seen, own, unit, small.even, small.row_counts, columns
    _take_away.in_spans(*given, count=math.prod(found.shape[:-1]), numbers=found.size)
    planes = change.reshape(-1, *change.shape[-2:])
    own = np.rint(rest * words.most).astype(np.int64)
    return Enlargement(planes, columns, bits, own, before)


_blend = native("layerfield.kernels.half_lanes", "blend")
_spread = native("layerfield.kernels.half_lanes", "spread")
_start = native("layerfield.kernels.half_lanes", "start")
_HALF, _PART = np.float32(0.5), np.float32(2**-16)


@compiled
def _take_away(change, found, seen, rest, unit, even, row_counts, columns, begin, end):
    """Rows of all planes, one after the other, from and to."""
    number, channels, rows = found.shape[1:4]
    for n in range(begin, end):
        plane, y = divmod(n, rows)
        both, channel = divmod(plane, channels)
        item, layer = divmod(both, number)
        to, own = change[item, layer, channel, y], found[item, layer, channel, y]
        light = seen[item, layer, channel, y]
        shares, dark = even[row_counts[layer, y], layer], rest[item, channel]
        for x in range(columns):
            share = _PART * np.float32(shares[x])
            start = share * np.float32(light[x]) if shares[x] > 0 else dark
            to[x] = np.int16(np.floor(unit * (np.float32(own[x]) - start) + _HALF))


@compiled
def room_to_enlarge(given):
    """Return what `enlarge_row` writes on."""
    length = given.change.shape[2]
    return np.zeros(length + 2 * WORDS, np.int16), np.zeros(2 * length + WORDS, np.int16)


@compiled
def enlarge_row(rows, given, words, place, beside, wide):
    """Write words of a row where they are and where those of one sweep ago are.

    Args:
        rows: addresses of both, and of b.
        given: an `Enlargement`.
        words: the normal equations.
        place: item, layer, channel and row.
        beside: see `room_to_enlarge`.
        wide: likewise.
    """
    item, layer, channel, y = place
    number, channels = words.row_counts.shape[0], given.rest.shape[1]
    plane = (item * number + layer) * channels + channel
    height, length = given.change.shape[1:]
    here, below = divmod(y + given.before[0], 2)
    other = min(max(here + 2 * below - 1, 0), height - 1)
    first, size = given.change.ctypes.data, 2 * length
    near, far = first + (plane * height + here) * size, first + (plane * height + other) * size
    _blend(beside.ctypes.data + 2 * WORDS, near, far, length)
    end = WORDS + given.columns
    beside[WORDS - 1], beside[end] = beside[WORDS], beside[end - 1]
    _spread(wide.ctypes.data, beside.ctypes.data + 2 * WORDS, length)
    count = words.row_counts[layer, y]
    shares = words.even.ctypes.data + 2 * (count * number + layer) * words.width
    change = wide.ctypes.data + 2 * given.before[1]
    rest = given.rest[item, channel]
    _start((*rows, shares, change), rest, given.bits, words.most, words.width)
