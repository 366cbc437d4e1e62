"""Sweeps over layers in 16-bit words, where light adds up and views stand in a grid.

As `grid_sweeps`, in whole numbers: sums are exact, pixels finer than panels show, and the last
sweep gives them as finely as its sums say. Layers become words, and layers again, on the way.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, UInt16
from torch import Tensor

from layerfield.kernels.compiled import compiled, native
from layerfield.kernels.halves import NOT_REFINED, Refinement, refine_row, room_to_refine
from layerfield.kernels.parts import parts_of, rows_at, steps_of
from layerfield.kernels.words import WORDS, Words

Layers = Float[Tensor, "*batch 1 layer c ly lx"]

_LOAD, _PUSH = -1, -2  # turns that are no layers
_GIVEN, _REFINED = 0, 1  # what is loaded
_ONE = 2**15  # what shares are parts of
_STRIDE = 40503  # golden section of 2^16: any number of sweeps round up evenly
_AT_ONCE = 4  # sweeps: of more, parts would be few


@dataclass(frozen=True, eq=False)
class LayerWords:
    """Layers between two sweeps, in words.

    Args:
        now: P.
        ago: P of one sweep ago.
    """

    now: UInt16[Tensor, "*batch 1 layer c ly words"]
    ago: UInt16[Tensor, "*batch 1 layer c ly words"]


def swept(
    words: Words,
    seen: UInt16[Tensor, "*batch 1 layer c ly words"],
    begun: Layers | LayerWords | Refinement,
    pushes: Sequence[float],
    made: int = 0,
) -> tuple[Layers, LayerWords]:
    """Return layers after sweeps, pixels from 0 to 1, and in words.

    Every sweep begins at clamp(P + push (P - P of one sweep ago)).

    Args:
        words: the normal equations.
        seen: b, see `seen_words`.
        begun: where sweeps begin: words, or layers whose rows are contiguous, and then clamped, or
            what rows of those are made of.
        pushes: of sweeps, less than 1; the first of layers that are no words yet is 0.
        made: sweeps made before: each rounds in a way of its own.

    Raises:
        ValueError: layers of another shape than those of the equations.
    """
    number, height = words.row_counts.shape
    channels, pixels = seen.shape[-3], words.shares.shape[1]
    expected, size = (1, number, channels, height, pixels), (*seen.shape[:-1], pixels)
    layers = torch.empty(size, dtype=torch.float32)
    is_new = not isinstance(begun, LayerWords)
    source = begun if isinstance(begun, Tensor) else layers
    fits = source.shape == size and source.stride(-1) == 1
    is_of_words = seen.is_contiguous() and seen.shape[-1] == words.width
    if size[-5:] != expected or not fits or not is_of_words:
        raise ValueError(f"found layers of shape {tuple(source.shape)}, expected {expected}")
    now, ago = (
        (torch.empty_like(seen), torch.empty_like(seen))
        if is_new
        else (begun.now.clone(), begun.ago.clone())
    )
    given = layers, now, ago, seen
    arrays = _Arrays(*(each.detach().flatten(end_dim=-5).numpy() for each in given))
    planes_of = source.detach().flatten(end_dim=-5).numpy()  # not to be let go before the end
    place = _Place(planes_of.ctypes.data, *planes_of.strides[:4])
    refinement = begun if isinstance(begun, Refinement) else NOT_REFINED
    loads = _REFINED if isinstance(begun, Refinement) else _GIVEN
    planes, reach = len(arrays.made) * channels, int(words.reach[0])
    for first in range(0, len(pushes), _AT_ONCE):
        turns = [(_LOAD, loads, 0)] if first == 0 and is_new else []
        for n, push in enumerate(pushes[first : first + _AT_ONCE], first):
            turns += (
                [(_PUSH, round(push * _ONE), (made + n) * _STRIDE % 2**16)]
                if n > 0 or not is_new
                else []
            )
            turns += [(k, 0, int(n == len(pushes) - 1)) for k in range(number)]
        parts, needs = parts_of(planes, height, reach, len(turns))
        passes, numbers = np.array(turns), len(turns) * layers.numel()
        _settle_parts.in_spans(
            arrays,
            (place, refinement),
            words,
            passes,
            parts,
            count=len(parts),
            numbers=numbers,
            needs=needs,
        )
    return layers, LayerWords(now, ago)


_ZERO = np.float32(0)
_ask_for = native("layerfield.kernels.ahead", "ask_for_bytes")
_add_up = native("layerfield.kernels.word_lanes", "add_up")
_add_masked = native("layerfield.kernels.word_lanes", "add_masked")
_settle = native("layerfield.kernels.word_lanes", "settle")
_push = native("layerfield.kernels.word_lanes", "push")
_to_words = native("layerfield.kernels.word_lanes", "to_words")
_to_light = native("layerfield.kernels.word_lanes", "to_light")


class _Arrays(NamedTuple):
    """`[n, layer, c, y, x]`: what is made; in words P, P of one sweep ago, and b."""

    made: np.ndarray
    now: np.ndarray
    ago: np.ndarray
    target: np.ndarray


class _Place(NamedTuple):
    """Where sweeps begin: an address, and bytes from one plane or row to the next.

    As an array it would have loops of its own for each way in which it may lie in memory.
    """

    address: int
    items: int
    layers: int
    channels: int
    rows: int


class _Kept(NamedTuple):
    """What a thread has for a row.

    Args:
        sums: of words over rows of each layer, with zeros on both sides.
        total: of those over columns, then what is left of b.
        found: addresses of rows.
        across: `[3, layer, band]`, addresses of sums: on the left, where all look, on the right.
        masks: `[2, layer, band]`, addresses of masks, on the left and on the right.
        light: of a layer, single precision.
        beside: see `room_to_refine`.
        wide: likewise.
    """

    sums: np.ndarray
    total: np.ndarray
    found: np.ndarray
    across: np.ndarray
    masks: np.ndarray
    light: np.ndarray
    beside: np.ndarray
    wide: np.ndarray


class _Room(NamedTuple):
    """Where that is: to hand arrays on for every row would count who holds them.

    Args:
        sums: address of the first layer's.
        stride: bytes to those of the next.
        total: address.
        across: likewise.
        masks: likewise.
        bands: of a layer in both tables.
    """

    sums: int
    stride: int
    total: int
    across: int
    masks: int
    bands: int


@compiled
def _settle_parts(arrays, begun, words, turns, parts, begin, end):
    """Parts from and to, turn by turn; see `parts_of`."""
    _, refinement = begun
    kept = _kept(words, arrays, refinement)
    _settle_with(kept, _room(words, kept), arrays, begun, words, turns, parts, begin, end)


@compiled
def _settle_with(kept, room, arrays, begun, words, turns, parts, begin, end):
    """The same, with what a thread has for a row.

    Turns make words of layers, push words on, or find a layer, the last ones as a picture, too.
    """
    number, channels, height = arrays.made.shape[1:4]
    reach, found, layer = words.reach[0], kept.found, channels * height
    for part in range(begin, end):
        item, channel = divmod(parts[part, 0], channels)
        above = (item * number * channels + channel) * height
        for step in range(*steps_of(parts, part, len(turns), reach)):
            for turn in range(len(turns)):
                what, share, last = turns[turn, 0], turns[turn, 1], turns[turn, 2]
                for y in range(*rows_at(parts, part, turn, step, reach)):
                    row = above + y
                    if what == _LOAD:
                        for j in range(number):
                            place = item, j, channel, y
                            _begin(kept, arrays, begun, words, place, row + j * layer, share)
                    elif what == _PUSH:
                        for j in range(number):
                            place = 2 * (row + j * layer) * words.width
                            rows = arrays.now.ctypes.data + place, arrays.ago.ctypes.data + place
                            known = (channel * number + j) * height + y
                            both = *rows, _thresholds(words, known)
                            _push(both, share, last, words.most, words.width)
                    else:
                        for j in range(number):
                            known = what, j, y
                            _add_rows(found, room, words, known, arrays.now, row + j * layer)
                        _add_columns(room, words, what, words.row_counts[what, y] > 0)
                        _find(arrays, words, room, (what, y), row + what * layer, last > 0)


@compiled
def _begin(kept, arrays, begun, words, place, row, kind):
    """Make words of a row, and have the next one fetched: it is read, and written on."""
    size, width = 2 * words.width, arrays.made.shape[4]
    for each in (arrays.target, arrays.now, arrays.ago):
        _ask_for(each.ctypes.data + (row + 1) * size, size)
    if kind == _REFINED:
        plane, y = divmod(row, arrays.made.shape[3])
        refine_row(kept.light, begun[1], plane, y, kept.beside, kept.wide)
        _load_layer(arrays, words, row, kept.light.ctypes.data)
    else:
        item, layer, channel, y = place
        here = _place_of(begun[0], item, layer, channel, y)
        _ask_for(here + begun[0].rows, 4 * width)
        _load_layer(arrays, words, row, here)


@compiled
def _thresholds(words, row):
    """Return where thresholds are, from another word on for every row."""
    return words.thresholds.ctypes.data + 2 * (
        row * _STRIDE % (len(words.thresholds) - words.width)
    )


@compiled
def _place_of(begun, item, layer, channel, y):
    """Return where a row is."""
    plane = begun.address + item * begun.items + layer * begun.layers + channel * begun.channels
    return plane + y * begun.rows


@compiled
def _load_layer(arrays, words, row, here):
    """Make words of a row of a layer."""
    place, most = 2 * row * words.width, np.float32(words.most)
    both = arrays.now.ctypes.data + place, arrays.ago.ctypes.data + place
    _to_words(both, here, most, most, arrays.made.shape[4])


@compiled
def _add_rows(found, room, words, place, layers, row):
    """Add up the rows of layer j that views show together with row y of layer k.

    Row y of layer j is the one of this number among all.
    """
    (k, j, y), n = place, 0
    first = layers.ctypes.data
    for band in range(words.begins[0, k, j], words.begins[0, k, j + 1]):
        if words.row_is_seen[k, band, y]:
            there = row + words.offsets[0, k, band]
            found[n] = first + 2 * there * words.width
            n += 1
    if n > 0:
        _add_up(room.sums + j * room.stride, found.ctypes.data, n, words.width)


@compiled
def _add_columns(room, words, k, is_seen):
    """Add up over columns; near both ends of a row not all views look."""
    n, total, long = words.begins[1, k, -1], room.total, words.width
    left, right = words.inside[k, 0], words.inside[k, 1]
    if n > 0 and is_seen:
        row, layer = 8 * k * room.bands, 8 * room.bands * len(words.inside)
        _add_masked(total, room.across + row, room.masks + row, n, left)
        _add_up(total + 2 * left, room.across + layer + row, n, right - left)
        to, across = total + 2 * right, room.across + 2 * layer
        _add_masked(to, across + row, room.masks + layer + row, n, long - right)
    else:
        _add_up(total, room.across, 0, long)


@compiled
def _find(arrays, words, room, place, row, is_last):
    """Find a row of a layer, as a picture, too, if nothing follows."""
    (k, y), width, total = place, arrays.made.shape[4], room.total
    count, here = words.row_counts[k, y], arrays.now.ctypes.data + 2 * row * words.width
    table = 2 * (count * words.gains.shape[1] + k) * words.width
    rows = (
        here,
        arrays.target.ctypes.data + 2 * row * words.width,
        total,
        words.halves.ctypes.data + table,
        words.gains.ctypes.data + table,
        words.powers.ctypes.data + table,
    )
    _settle(rows, words.most, words.width)
    if is_last:
        unit = np.float32(1 / words.most)
        gain = unit / np.float32(count) if count > 0 else _ZERO
        made = arrays.made.ctypes.data + 4 * row * width
        _ask_for(made + 4 * width, 4 * width)
        _to_light((made, words.shares.ctypes.data + 4 * k * width, total, here), gain, unit, width)


@compiled
def _kept(words, arrays, refinement):
    """Return memory for a row."""
    number, bands = words.offsets.shape[1:]
    side = -(-words.reach[1] // WORDS) * WORDS
    sums = np.zeros((number, words.width + 2 * side), np.uint16)
    across, masks = np.empty((3, number, bands), np.int64), np.empty((2, number, bands), np.int64)
    for k in range(number):
        left, right = words.inside[k]
        for j in range(number):
            for band in range(words.begins[1, k, j], words.begins[1, k, j + 1]):
                first = j * sums.shape[1] + side + words.offsets[1, k, band]
                for n, place in enumerate((0, left, right)):
                    across[n, k, band] = sums.ctypes.data + 2 * (first + place)
                mask = words.masks.ctypes.data + 2 * (k * bands + band) * words.width
                masks[0, k, band], masks[1, k, band] = mask, mask + 2 * right
    total, found = np.zeros(words.width, np.uint16), np.empty(bands, np.int64)
    light = np.empty(arrays.made.shape[4], np.float32)
    beside, wide = room_to_refine(refinement)
    return _Kept(sums, total, found, across, masks, light, beside, wide)


@compiled
def _room(words, kept):
    """Return where that memory is."""
    stride = 2 * kept.sums.shape[1]
    first = kept.sums.ctypes.data + (stride - 2 * words.width) // 2
    tables = kept.across.ctypes.data, kept.masks.ctypes.data
    return _Room(first, stride, kept.total.ctypes.data, *tables, kept.across.shape[2])
