"""What words of whole size begin as, where light adds up: layers of half size, brought there.

    P = e up(Q / e of half size),  with e the balanced start

Row by row, right before sweeps look at them. What is in brackets is known once, as whole numbers of
14 bits; up is linear interpolation of those. Without it they begin as e. What was found for gray
is brought to all colours likewise, without up.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt16
from torch import Tensor

from layerfield.kernels.compiled import compiled, native
from layerfield.kernels.words import WORDS, Words

_LARGEST_WORD = 2**16 - 1
_LARGEST = 2**14 - 1  # of numbers, sums of four of which are words
_FINE = 11  # bits of a ratio behind its point, at the least: up to 8 fits


class Enlargement(NamedTuple):
    """What words begin as, for compiled loops; see `enlargement_of` and `balanced`.

    Args:
        ratio: `[plane, hy, more]`, Q / e of half size, or of whole size and gray; beyond the last
            column what was in memory.
        columns: how many it has; none where all ratios are 1.
        is_half: whether it is that of half size.
        bits: of a ratio that stand behind its point.
        rest: `[item, channel]`, words of pixels that nobody sees.
        before: pixels of whole size by which those of half size begin before the others.
    """

    ratio: np.ndarray
    columns: int
    is_half: bool
    bits: int
    rest: np.ndarray
    before: tuple[int, int]


NOT_ENLARGED = Enlargement(
    np.zeros((0, 0, 0), np.uint16), 0, True, 0, np.zeros((0, 0), np.int64), (0, 0)
)


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


def balanced(words: Words, rest: Float[np.ndarray, "item c"]) -> Enlargement:
    """Return the balanced start alone.

    Args:
        words: the normal equations.
        rest: light of pixels that nobody sees.
    """
    none = np.zeros((0, 0, words.width), np.uint16)
    return Enlargement(none, 0, True, _bits_of(words), _of(words, rest), (0, 0))


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
    bits = _bits_of(words)
    ratio = _ratio_of(half, rest, bits)
    columns = half.words.shares.shape[1]
    return Enlargement(ratio, columns, True, bits, _of(words, rest), before)


def coloured(gray: HalfWords, rest: Float[np.ndarray, "item c"]) -> Enlargement:
    """Return what brings gray layers to all colours.

    Args:
        gray: what is known of them.
        rest: light of pixels that nobody sees, of every colour.
    """
    words = gray.words
    bits, mean = _bits_of(words), rest.mean(axis=1, keepdims=True)
    ratio = _ratio_of(gray, mean, bits)
    return Enlargement(ratio, words.shares.shape[1], False, bits, _of(words, rest), (0, 0))


def _ratio_of(
    known: HalfWords, rest: Float[np.ndarray, "item c"], bits: int
) -> UInt16[np.ndarray, "plane y more"]:
    """Return Q / e with so many bits behind the point."""
    words = known.words
    columns = words.shares.shape[1]
    found, seen = (
        each.contiguous().view(-1, *each.shape[-4:]).numpy() for each in (known.found, known.seen)
    )
    ratio = np.empty((*found.shape[:-1], -(-columns // WORDS) * WORDS), np.uint16)
    dark, unit = (rest * words.most).astype(np.float32), np.float32(1 << bits)
    given = ratio, found, seen, dark, unit, words.even, words.row_counts, columns
    _divide.in_spans(*given, count=math.prod(found.shape[:-1]), numbers=found.size)
    return ratio.reshape(-1, *ratio.shape[-2:])


def largest_ratio(words: Words) -> float:
    """Return what no ratio of layers of that whole size goes beyond."""
    return _LARGEST / (1 << _bits_of(words))


def _bits_of(words: Words) -> int:
    """Return as many as leave the others of 16 for e, no more than a layer's share of 1."""
    left = int(math.log2(_LARGEST_WORD * len(words.order) / words.most))
    return max(_FINE, 16 - left)


def _of(words: Words, light: Float[np.ndarray, "item c"]) -> np.ndarray:
    """Return words of light."""
    return np.rint(light * words.most).astype(np.int64)


_blend = native("layerfield.kernels.half_lanes", "blend")
_spread = native("layerfield.kernels.half_lanes", "spread")
_start = native("layerfield.kernels.half_lanes", "start")
_ONE, _HALF, _PART = np.float32(1), np.float32(0.5), np.float32(2**-16)
_MOST = np.float32(_LARGEST)


@compiled
def _divide(ratio, found, seen, rest, unit, even, row_counts, columns, begin, end):
    """Rows of all planes, one after the other, from and to; of words, 1 more each: none is 0."""
    number, channels, rows = found.shape[1:4]
    for n in range(begin, end):
        plane, y = divmod(n, rows)
        both, channel = divmod(plane, channels)
        item, layer = divmod(both, number)
        to, own = ratio[item, layer, channel, y], found[item, layer, channel, y]
        light = seen[item, layer, channel, y]
        shares, dark = even[row_counts[layer, y], layer], rest[item, channel]
        for x in range(columns):
            share = _PART * np.float32(shares[x])
            start = share * np.float32(light[x]) if shares[x] > 0 else dark
            part = unit * (np.float32(own[x]) + _ONE) / (start + _ONE)
            to[x] = np.uint16(min(part + _HALF, _MOST))


@compiled
def room_to_enlarge(given):
    """Return what `enlarge_row` writes on."""
    length = given.ratio.shape[2]
    wide = np.empty(2 * length + WORDS, np.uint16)
    for x in range(len(wide)):
        wide[x] = 1 << given.bits
    return np.zeros(length + 2 * WORDS, np.uint16), wide


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
    height, length = given.ratio.shape[1:]
    first, size = given.ratio.ctypes.data, 2 * length
    ratio = wide.ctypes.data + 2 * given.before[1]
    if given.columns > 0 and given.is_half:
        plane = (item * number + layer) * channels + channel
        here, below = divmod(y + given.before[0], 2)
        other = min(max(here + 2 * below - 1, 0), height - 1)
        near, far = first + (plane * height + here) * size, first + (plane * height + other) * size
        _blend(beside.ctypes.data + 2 * WORDS, near, far, length)
        end = WORDS + given.columns
        beside[WORDS - 1], beside[end] = beside[WORDS], beside[end - 1]
        _spread(wide.ctypes.data, beside.ctypes.data + 2 * WORDS, length)
    elif given.columns > 0:
        ratio = first + ((item * number + layer) * height + y) * size
    count = words.row_counts[layer, y]
    shares = words.even.ctypes.data + 2 * (count * number + layer) * words.width
    rest = given.rest[item, channel]
    _start((*rows, shares, ratio), rest, given.bits, words.most, words.width)
