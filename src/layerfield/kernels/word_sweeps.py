"""Sweeps over layers in 16-bit words, where light adds up and views stand in a grid.

As `grid_sweeps`, in whole numbers: sums are exact, pixels finer than panels show, and the last
sweep gives them as finely as its sums say. Layers become words, and layers again, on the way.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, UInt16
from torch import Tensor

from layerfield.kernels.compiled import compiled, native
from layerfield.kernels.half_words import (
    NOT_ENLARGED,
    Enlargement,
    enlarge_row,
    room_to_enlarge,
)
from layerfield.kernels.parts import TOGETHER, parts_of, rows_at, steps_of
from layerfield.kernels.words import WORDS, Words

Layers = Float[Tensor, "*batch 1 layer c ly lx"]

_LOAD, _PUSH = -1, -2  # turns that are no layers
_GIVEN, _ENLARGED = 0, 1  # what is loaded
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
    begun: Layers | LayerWords | Enlargement,
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
    is_enlarged = isinstance(begun, Enlargement)
    loads = (_ENLARGED if is_enlarged else _GIVEN) if is_new else None
    planes = len(arrays.made) * channels, height, int(words.reach[0])
    plan = _plan(planes, tuple(words.order.tolist()), loads, tuple(pushes), made)
    numbers, count = len(plan.turns) * layers.numel(), len(plan.parts)
    given = (
        arrays,
        (place, begun if is_enlarged else NOT_ENLARGED),
        words,
        plan.turns,
        plan.which,
        plan.parts,
    )
    _settle_parts.in_spans(*given, count=count, numbers=numbers, needs=plan.needs)
    return layers, LayerWords(now, ago)


class _Plan(NamedTuple):
    """Which turns rows have.

    Args:
        turns: `[turn, 3]`: what is done, with what, and whether a picture is made.
        which: `[part, 2]`, the first turn of a part, and how many it has.
        parts: see `parts_of`.
        needs: likewise.
    """

    turns: np.ndarray
    which: np.ndarray
    parts: np.ndarray
    needs: np.ndarray


@lru_cache(maxsize=64)
def _plan(
    planes: tuple[int, int, int],
    order: tuple[int, ...],
    loads: int | None,
    pushes: tuple[float, ...],
    made: int,
) -> _Plan:
    """Return the turns of sweeps, a few at once and then the next.

    Args:
        planes: how many, their height, and how far rows look.
        order: of layers.
        loads: what is loaded, where there are no words.
        pushes: of sweeps.
        made: sweeps made before.
    """
    turns: list[tuple[int, int, int]] = []
    which, parts, needs = [], [], []
    for first in range(0, len(pushes), _AT_ONCE):
        begin, before = len(turns), sum(map(len, parts))
        if first == 0 and loads is not None:
            turns.append((_LOAD, loads, 0))
        for n, push in enumerate(pushes[first : first + _AT_ONCE], first):
            if n > 0 or loads is None:
                turns.append((_PUSH, round(push * _ONE), (made + n) * _STRIDE % 2**16))
            turns += [(k, 0, int(n == len(pushes) - 1)) for k in order]
        own, needed = parts_of(*planes, len(turns) - begin)
        which += [(begin, len(turns) - begin)] * len(own)
        parts.append(own)
        needs.append(before + needed)
    return _Plan(np.array(turns), np.array(which), np.concatenate(parts), np.concatenate(needs))


_ZERO = np.float32(0)
_ask_for = native("layerfield.kernels.ahead", "ask_for_bytes")
_add_up = native("layerfield.kernels.word_lanes", "add_up")
_add_up_both = native("layerfield.kernels.word_lanes", "add_up_both")
_add_masked = native("layerfield.kernels.word_lanes", "add_masked")
_settle_inside = native("layerfield.kernels.word_lanes", "settle_inside")
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
    """What a thread has for the rows of a turn.

    Args:
        sums: `[row, layer, word]`, over rows of each layer, with zeros on both sides.
        total: of those over columns, then what is left of b.
        found: addresses of rows.
        across: `[row, 3, layer, band]`, those of sums: on the left, where all look, on the right.
        masks: `[2, layer, band]`, addresses of masks, on the left and on the right.
        beside: see `room_to_enlarge`.
        wide: likewise.
    """

    sums: np.ndarray
    total: np.ndarray
    found: np.ndarray
    across: np.ndarray
    masks: np.ndarray
    beside: np.ndarray
    wide: np.ndarray


class _Room(NamedTuple):
    """Where that is: to hand arrays on for every row would count who holds them.

    Args:
        sums: address of the first layer's.
        layers: bytes to those of the next.
        rows: bytes to those of the next row.
        total: address.
        across: likewise.
        masks: likewise.
        bands: of a layer in both tables.
    """

    sums: int
    layers: int
    rows: int
    total: int
    across: int
    masks: int
    bands: int


@compiled
def _settle_parts(arrays, begun, words, turns, which, parts, begin, end):
    """Parts from and to, turn by turn; see `_Plan`."""
    kept = _kept(words, begun[1])
    plan = turns, which, parts
    _settle_with(kept, _room(words, kept), arrays, begun, words, plan, begin, end)


@compiled
def _settle_with(kept, room, arrays, begun, words, plan, begin, end):
    """The same, with what a thread has for a row.

    Turns make words of layers, push words on, or find a layer, the last ones as a picture, too.
    """
    (number, channels, height), (turns, which, parts) = arrays.made.shape[1:4], plan
    reach, found, layer = words.reach[0], kept.found, channels * height
    for part in range(begin, end):
        item, channel = divmod(parts[part, 0], channels)
        above = (item * number * channels + channel) * height
        first, count = which[part, 0], which[part, 1]
        for step in range(*steps_of(parts, part, count, reach)):
            for turn in range(count):
                n = first + turn
                what, share, last = turns[n, 0], turns[n, 1], turns[n, 2]
                top, bottom = rows_at(parts, part, turn, step, reach)
                if what == _LOAD:
                    for y in range(top, bottom):
                        for j in range(number):
                            place = item, j, channel, y
                            _begin(kept, arrays, begun, words, place, above + y + j * layer, share)
                elif what == _PUSH:
                    for y in range(top, bottom):
                        for other in range(1, number):  # the first is found before it is seen
                            j = words.order[other]
                            row = 2 * (above + y + j * layer) * words.width
                            rows = arrays.now.ctypes.data + row, arrays.ago.ctypes.data + row
                            known = (channel * number + j) * height + y
                            both = *rows, _thresholds(words, known)
                            _push(both, share, last, words.most, words.used)
                else:
                    for j in range(number):
                        known = what, j, top, bottom
                        _add_rows(found, room, words, known, arrays.now, above + j * layer)
                    for y in range(top, bottom):
                        row = above + y + what * layer
                        _find(arrays, words, room, (what, y, y - top), row, last > 0)


@compiled
def _begin(kept, arrays, begun, words, place, row, kind):
    """Make words of a row, and have the next one fetched: it is read, and written on."""
    size, width = 2 * words.width, arrays.made.shape[4]
    for each in (arrays.target, arrays.now, arrays.ago):
        _ask_for(each.ctypes.data + (row + 1) * size, size)
    here = 2 * row * words.width
    both = arrays.now.ctypes.data + here, arrays.ago.ctypes.data + here
    if kind == _ENLARGED:
        rows = *both, arrays.target.ctypes.data + here
        enlarge_row(rows, begun[1], words, place, kept.beside, kept.wide)
    else:
        item, layer, channel, y = place
        there, most = _place_of(begun[0], item, layer, channel, y), np.float32(words.most)
        _ask_for(there + begun[0].rows, 4 * width)
        _to_words(both, there, most, most, width)


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
def _add_rows(found, room, words, place, layers, above):
    """Add up the rows of layer j that views show together with each of some rows of layer k.

    Of two rows that look at the same ones but for one each, what they share is added up once. The
    first row of layer j is the one of this number among all.
    """
    k, j, top, bottom = place
    first, size, step = layers.ctypes.data, 2 * words.width, words.steps[k, j]
    begin, end = words.begins[0, k, j], words.begins[0, k, j + 1]
    low, high = words.inside[0, k, 0], min(words.inside[0, k, 1], bottom)
    for y in range(top, bottom):
        to = room.sums + j * room.layers + (y - top) * room.rows
        turn = (y - top) // step % 2 if step > 0 else 0
        if step > 0 and turn == 0 and low <= y and y + step < high:
            for band in range(begin + 1, end):
                found[band - begin - 1] = first + (above + y + words.offsets[0, k, band]) * size
            found[end - begin - 1] = first + (above + y + words.offsets[0, k, begin]) * size
            last = above + y + step + words.offsets[0, k, end - 1]
            found[end - begin] = first + last * size
            both = to, to + step * room.rows
            _add_up_both(both, found.ctypes.data, end - begin - 1, words.used)
        elif turn == 0 or y - step < low or y >= high:
            n = 0
            for band in range(begin, end):
                if words.row_is_seen[k, band, y]:
                    found[n] = first + (above + y + words.offsets[0, k, band]) * size
                    n += 1
            if n > 0:
                _add_up(to, found.ctypes.data, n, words.used)


@compiled
def _find(arrays, words, room, place, row, is_last):
    """Find a row of a layer, as a picture, too, if nothing follows.

    Near its ends not all views look.
    """
    (k, y, n), width, total = place, arrays.made.shape[4], room.total
    count, size = words.row_counts[k, y], 2 * row * words.width
    here, seen = arrays.now.ctypes.data + size, arrays.target.ctypes.data + size
    left, right = words.inside[1, k, 0], words.inside[1, k, 1]
    if count > 0:
        bands, layer = words.begins[1, k, -1], 8 * len(words.order) * room.bands
        across, masks = room.across + 8 * k * room.bands, room.masks + 8 * k * room.bands
        across += 3 * n * layer
        table = 2 * (count * words.gains.shape[1] + k) * words.width
        rows = (
            here,
            seen,
            total,
            words.halves.ctypes.data + table,
            words.gains.ctypes.data + table,
            words.powers.ctypes.data + table,
        )
        most, beyond = words.most, words.used - right
        _add_masked(total, across, masks, bands, left)
        _settle(rows, most, left)
        if left < right:
            quotient = words.inner[count, k, 0], words.inner[count, k, 1]
            inner = here + 2 * left, seen + 2 * left, total + 2 * left, rows[4] + 2 * left
            _settle_inside(inner, across + layer, bands, quotient, most, right - left)
        across += 2 * layer
        _add_masked(total + 2 * right, across, masks + layer, bands, beyond)
        _settle(_moved(rows, 2 * right), most, beyond)
    if is_last:
        unit = np.float32(1 / words.most)
        gain = unit / np.float32(count) if count > 0 else _ZERO
        made = arrays.made.ctypes.data + 4 * row * width
        _ask_for(made + 4 * width, 4 * width)
        _to_light((made, words.shares.ctypes.data + 4 * k * width, total, here), gain, unit, width)


@compiled
def _moved(rows, by):
    """Return addresses, so many bytes further on."""
    made, seen, rest, half, gain, power = rows
    return made + by, seen + by, rest + by, half + by, gain + by, power + by


@compiled
def _kept(words, enlargement):
    """Return memory for the rows of a turn."""
    number, bands = words.offsets.shape[1:]
    side = -(-words.reach[1] // WORDS) * WORDS
    sums = np.zeros((TOGETHER, number, words.width + 2 * side), np.uint16)
    across = np.empty((TOGETHER, 3, number, bands), np.int64)
    masks = np.empty((2, number, bands), np.int64)
    for k in range(number):
        left, right = words.inside[1, k]
        for j in range(number):
            for band in range(words.begins[1, k, j], words.begins[1, k, j + 1]):
                first = j * sums.shape[2] + side + words.offsets[1, k, band]
                for n, place in enumerate((0, left, right)):
                    for row in range(TOGETHER):
                        there = row * number * sums.shape[2] + first + place
                        across[row, n, k, band] = sums.ctypes.data + 2 * there
                mask = words.masks.ctypes.data + 2 * (k * bands + band) * words.width
                masks[0, k, band], masks[1, k, band] = mask, mask + 2 * right
    total, found = np.zeros(words.width, np.uint16), np.empty(bands + 1, np.int64)
    return _Kept(sums, total, found, across, masks, *room_to_enlarge(enlargement))


@compiled
def _room(words, kept):
    """Return where that memory is."""
    layers = 2 * kept.sums.shape[2]
    rows = layers * kept.sums.shape[1]
    first = kept.sums.ctypes.data + (layers - 2 * words.width) // 2
    tables = kept.across.ctypes.data, kept.masks.ctypes.data
    return _Room(first, layers, rows, kept.total.ctypes.data, *tables, kept.across.shape[3])
