"""What a thread keeps for rows of words while it sweeps over them; see `word_sweeps`."""

from typing import NamedTuple

import numpy as np

from layerfield.kernels.compiled import compiled
from layerfield.kernels.half_words import room_to_enlarge
from layerfield.kernels.parts import TOGETHER
from layerfield.kernels.words import WORDS


class Kept(NamedTuple):
    """What a thread has for the rows of a turn.

    Args:
        sums: `[row, layer, word]`, over rows of each layer, with zeros on both sides.
        left: `[row, word]`, what is left of b.
        pairs: `[layer, other, row]`, bytes from the first byte of a row of the other layer beneath
            one of the layer to those that this one and the next pair with, see `add_up_both`.
        found: addresses of rows.
        across: `[row, layer, band]`, those of sums, moved as views have it.
        masks: `[layer, band]`, those of masks.
        floor: a row of zeros, the least P where none is told.
        beside: see `room_to_enlarge`.
        wide: likewise.
    """

    sums: np.ndarray
    left: np.ndarray
    pairs: np.ndarray
    found: np.ndarray
    across: np.ndarray
    masks: np.ndarray
    floor: np.ndarray
    beside: np.ndarray
    wide: np.ndarray


class Room(NamedTuple):
    """Where that is: to hand arrays on for every row would count who holds them.

    Args:
        sums: address of the first layer's.
        layers: bytes to those of the next.
        rows: bytes to those of the next row.
        left: address.
        pairs: likewise.
        length: rows of a pair, at the most.
        across: address.
        masks: likewise.
        bands: of a layer in both.
        floor: address of the first row.
        apart: words from there to the next one.
    """

    sums: int
    layers: int
    rows: int
    left: int
    pairs: int
    length: int
    across: int
    masks: int
    bands: int
    floor: int
    apart: int


@compiled
def kept_for(words, enlargement):
    """Return memory for the rows of a turn."""
    number, bands = words.offsets.shape[1:]
    side = -(-words.reach[1] // WORDS) * WORDS
    sums = _aligned((TOGETHER, number, words.width + 2 * side))
    across = np.empty((TOGETHER, number, bands), np.int64)
    masks = np.empty((number, bands), np.int64)
    for k in range(number):
        for j in range(number):
            for band in range(words.begins[1, k, j], words.begins[1, k, j + 1]):
                first = j * sums.shape[2] + side + words.offsets[1, k, band]
                for row in range(TOGETHER):
                    there = row * number * sums.shape[2] + first
                    across[row, k, band] = sums.ctypes.data + 2 * there
                masks[k, band] = words.masks.ctypes.data + 2 * (k * bands + band) * words.width
    left, found = np.zeros((TOGETHER, words.width), np.uint16), np.empty(bands, np.int64)
    kept = sums, left, _pairs(words), found, across, masks, np.zeros(words.width, np.uint16)
    return Kept(*kept, *room_to_enlarge(enlargement))


@compiled
def _aligned(shape):
    """Return words, all 0, that begin where lines of the cache do: else each vector is in two."""
    rows, number, length = shape
    room = np.zeros(rows * number * length + WORDS, np.uint16)
    first = -(room.ctypes.data // 2) % WORDS
    return room[first : first + rows * number * length].reshape(shape)


@compiled
def _pairs(words):
    """Return what `Kept` says of two rows side by side."""
    number, bands = words.offsets.shape[1:]
    made = np.zeros((number, number, bands + 1), np.int64)
    for k in range(number):
        for j in range(number):
            begin, last = words.begins[0, k, j], words.begins[0, k, j + 1] - 1
            for band in range(begin, last):
                made[k, j, band - begin] = words.offsets[0, k, band + 1]
            if begin <= last:
                made[k, j, last - begin] = words.offsets[0, k, begin]
                made[k, j, last - begin + 1] = words.offsets[0, k, last] + words.steps[k, j]
    return made * (2 * words.width)


@compiled
def room_of(words, kept, arrays):
    """Return where that memory is, and the least P."""
    layers = 2 * kept.sums.shape[2]
    rows = layers * kept.sums.shape[1]
    first = kept.sums.ctypes.data + (layers - 2 * words.width) // 2
    pairs = kept.pairs.ctypes.data, kept.pairs.shape[2]
    tables = kept.across.ctypes.data, kept.masks.ctypes.data, kept.across.shape[2]
    floor = kept.floor.ctypes.data, 0
    if arrays.floor.size > 0:
        floor = arrays.floor.ctypes.data, words.width
    return Room(first, layers, rows, kept.left.ctypes.data, *pairs, *tables, *floor)
