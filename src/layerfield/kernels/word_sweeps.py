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
from layerfield.kernels.half_words import (
    NOT_ENLARGED,
    Enlargement,
    enlarge_row,
)
from layerfield.kernels.parts import TOGETHER, rows_at, steps_of
from layerfield.kernels.word_room import kept_for, room_of
from layerfield.kernels.word_turns import (
    ENLARGED,
    GIVEN,
    LOAD,
    NOT_PUSHED,
    PUSH,
    STRIDE,
    turns_of,
)
from layerfield.kernels.words import NOISE, Words

Layers = Float[Tensor, "*batch 1 layer c ly lx"]


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
    floor: UInt16[Tensor, "*batch 1 layer c ly words"] | None = None,
) -> tuple[Layers | None, LayerWords]:
    """Return layers after sweeps, pixels from 0 to 1, and in words.

    Every sweep begins at clamp(P + push (P - P of one sweep ago)).

    Args:
        words: the normal equations.
        seen: b, see `seen_words`.
        begun: where sweeps begin: words, or layers whose rows are contiguous, and then clamped, or
            what rows of those are made of.
        pushes: of sweeps, less than 1; the first of layers that are no words yet is 0.
        made: sweeps made before: each rounds in a way of its own.
        floor: the least that pixels may be, in words, 0 where no view sees them. Words are all
            that is returned then: who tells one does not show layers. None for 0.

    Raises:
        ValueError: layers of another shape than those of the equations.
    """
    number, height = words.row_counts.shape
    channels, pixels = seen.shape[-3], words.shares.shape[1]
    expected, size = (1, number, channels, height, pixels), (*seen.shape[:-1], pixels)
    shows = floor is None
    layers = torch.empty(size if shows else (0, *size[1:]), dtype=torch.float32)
    is_new = not isinstance(begun, LayerWords)
    source = begun if isinstance(begun, Tensor) else layers
    found = source.shape if source is begun else size
    is_of_words = seen.is_contiguous() and seen.shape[-1] == words.width
    is_in_rows = source is not begun or source.stride(-1) == 1
    if size[-5:] != expected or found != size or not is_in_rows or not is_of_words:
        raise ValueError(f"found layers of shape {tuple(found)}, expected {expected}")
    now, ago = (
        (torch.empty_like(seen), torch.empty_like(seen))
        if is_new
        else (begun.now.clone(), begun.ago.clone())
    )
    given = layers, now, ago, seen, seen[:0] if floor is None else floor
    arrays = _Arrays(*(each.numpy().reshape(-1, *each.shape[-4:]) for each in given))
    planes_of = source.detach().flatten(end_dim=-5).numpy()  # not to be let go before the end
    place = _Place(planes_of.ctypes.data, *planes_of.strides[:4])
    is_enlarged = isinstance(begun, Enlargement)
    loads = (ENLARGED if is_enlarged else GIVEN) if is_new else None
    planes, order = (len(arrays.now) * channels, height, int(words.reach[0])), words.order
    plan = turns_of(planes, tuple(order.tolist()), loads, tuple(pushes), made, shows=shows)
    numbers, count = len(plan.turns) * seen.numel(), len(plan.parts)
    enlargement = begun if is_enlarged else NOT_ENLARGED
    given = arrays, (place, enlargement), words, plan
    _settle_parts.in_spans(*given, count=count, numbers=numbers, needs=plan.needs)
    return layers if shows else None, LayerWords(now, ago)


_ZERO = np.float32(0)
_ask_for = native("layerfield.kernels.ahead", "ask_for_bytes")
_add_up = native("layerfield.kernels.word_lanes", "add_up")
_add_up_both = native("layerfield.kernels.word_lanes", "add_up_both")
_settle_inside = native("layerfield.kernels.word_lanes", "settle_inside")
_settle = native("layerfield.kernels.word_lanes", "settle")
_push = native("layerfield.kernels.word_lanes", "push")
_to_words = native("layerfield.kernels.word_lanes", "to_words")
_to_light = native("layerfield.kernels.word_lanes", "to_light")


class _Arrays(NamedTuple):
    """`[n, layer, c, y, x]`: what is made; in words P, P of one sweep ago, b, and the least P."""

    made: np.ndarray
    now: np.ndarray
    ago: np.ndarray
    target: np.ndarray
    floor: np.ndarray


class _Place(NamedTuple):
    """Where sweeps begin: an address, and bytes from one plane or row to the next.

    As an array it would have loops of its own for each way in which it may lie in memory.
    """

    address: int
    items: int
    layers: int
    channels: int
    rows: int


@compiled
def _settle_parts(arrays, begun, words, plan, begin, end):
    """Parts from and to, turn by turn; see `Turns`."""
    kept = kept_for(words, begun[1])
    _settle_with(kept, room_of(words, kept, arrays), arrays, begun, words, plan, begin, end)


@compiled
def _settle_with(kept, room, arrays, begun, words, plan, begin, end):
    """The same, with what a thread has for a row.

    Turns make words of layers, push words on, or find a layer, the last ones as a picture, too.
    """
    (number, channels, height), (turns, are_before, which, parts, _) = arrays.now.shape[1:4], plan
    reach, layer = words.reach[0], channels * height
    for part in range(begin, end):
        item, channel = divmod(parts[part, 0], channels)
        above = (item * number * channels + channel) * height
        first, count = which[part, 0], which[part, 1]
        for step in range(*steps_of(parts, part, count, reach)):
            for turn in range(count):
                n = first + turn
                what, share, rise = turns[n, 0], turns[n, 1], turns[n, 2]
                top, bottom = rows_at(parts, part, turn, step, reach)
                if what == LOAD:
                    for y in range(top, bottom):
                        for j in range(number):
                            place = item, j, channel, y
                            _begin(kept, arrays, begun, words, place, above + y + j * layer, share)
                elif what == PUSH:
                    for y in range(top, bottom):
                        for other in range(1, number):  # the first is found before it is seen
                            j = words.order[other]
                            row = above + y + j * layer
                            here = 2 * row * words.width
                            rows = arrays.now.ctypes.data + here, arrays.ago.ctypes.data + here
                            least = room.floor + 2 * row * room.apart
                            known = (channel * number + j) * height + y
                            every = *rows, least, _thresholds(words, known)
                            _push(every, share, rise, words.most, words.width)
                else:
                    size = 2 * words.width
                    for j in range(number):
                        known = what, j, top, bottom
                        seen = arrays.ago if are_before[n, j] else arrays.now
                        there = seen.ctypes.data + (above + top + j * layer) * size
                        _add_rows(kept.found, room, words, known, there)
                    row = above + top + what * layer
                    known = what, top, bottom, row, (channel * number + what) * height
                    _find_rows(arrays, room, words, known, (share, rise, turns[n, 3]))


@compiled
def _begin(kept, arrays, begun, words, place, row, kind):
    """Make words of a row, and have the next one fetched: it is read, and written on."""
    size, width = 2 * words.width, words.shares.shape[1]
    for each in (arrays.target, arrays.now, arrays.ago):
        _ask_for(each.ctypes.data + (row + 1) * size, size)
    here = 2 * row * words.width
    both = arrays.now.ctypes.data + here, arrays.ago.ctypes.data + here
    if kind == ENLARGED:
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
    return words.thresholds.ctypes.data + 2 * (row * STRIDE % NOISE)


@compiled
def _place_of(begun, item, layer, channel, y):
    """Return where a row is."""
    plane = begun.address + item * begun.items + layer * begun.layers + channel * begun.channels
    return plane + y * begun.rows


@compiled
def _add_rows(found, room, words, place, first):
    """Add up the rows of layer j that views show together with each of some rows of layer k.

    Of two rows that look at the same ones but for one each, what they share is added up once. The
    row of layer j beneath the first one is at an address.
    """
    (k, j, top, bottom), number = place, len(words.order)
    begin, end, step = words.begins[0, k, j], words.begins[0, k, j + 1], words.steps[k, j]
    low, high = words.inside[0, k, 0], min(words.inside[0, k, 1], bottom)
    to, pair = room.sums + j * room.layers, room.pairs + 8 * room.length * (k * number + j)
    y, apart, shared, size = top, max(step, 1), end - begin - 1, 2 * words.width
    while begin < end and y < bottom:
        for one in range(y, min(y + apart, bottom)):
            n, other = one - top, one + apart
            there, here = to + n * room.rows, first + n * size
            if step > 0 and low <= one and other < high:
                both = there, there + step * room.rows
                _add_up_both(both, here, pair, shared, words.width)
            else:
                _add_row(found, words, (k, j, one), there, here)
                if other < bottom:
                    below, beneath = there + apart * room.rows, here + apart * size
                    _add_row(found, words, (k, j, other), below, beneath)
        y += 2 * apart


@compiled
def _add_row(found, words, place, to, first):
    """The same for one row."""
    (k, j, y), size, number = place, 2 * words.width, 0
    for band in range(words.begins[0, k, j], words.begins[0, k, j + 1]):
        if words.row_is_seen[k, band, y]:
            found[number] = first + words.offsets[0, k, band] * size
            number += 1
    if number > 0:
        _add_up(to, found.ctypes.data, number, words.width)


@compiled
def _find_rows(arrays, room, words, place, turn):
    """Find rows of a layer, and push them on, or show them, as their turn has it.

    The first is the one of this number among all, and those of its layer have thresholds from
    another number on. Where all positions see them, as many as there are go side by side.
    """
    (k, top, bottom, row, known), (share, rise, is_last) = place, turn
    is_pushed, size = share != NOT_PUSHED, 2 * words.width
    now, ago = arrays.now.ctypes.data, arrays.ago.ctypes.data
    target, here = arrays.target.ctypes.data, row * size
    low, high = words.inside[0, k, 0], words.inside[0, k, 1]
    at_once = low <= top and bottom <= high and bottom - top == TOGETHER
    if at_once:
        rows, first = (now + here, target + here, room.floor + 2 * row * room.apart), (k, top, 0)
        if is_pushed:
            ahead, noise = (ago + here, share, rise), _four_thresholds(words, known + top)
            _find(words, room, rows, ahead, noise, first)
        else:
            _find(words, room, rows, (), (0, 0, 0, 0), first)
    for y in range(top, bottom):
        n, there = y - top, here + (y - top) * size
        if not at_once and words.row_counts[k, y] > 0:
            rows = now + there, target + there, room.floor + 2 * (row + n) * room.apart
            if is_pushed:
                ahead, noise = (ago + there, share, rise), (_thresholds(words, known + y),)
                _find(words, room, rows, ahead, noise, (k, y, n))
            else:
                _find(words, room, rows, (), (0,), (k, y, n))
        if is_last:
            _show(arrays, words, room.left + n * size, k, y, row + n)


@compiled
def _four_thresholds(words, row):
    """Return the thresholds of `TOGETHER` rows."""
    return (
        _thresholds(words, row),
        _thresholds(words, row + 1),
        _thresholds(words, row + 2),
        _thresholds(words, row + 3),
    )


@compiled
def _find(words, room, here, ahead, noise, place):
    """Find rows that as many views see; see `settle`. Near their ends not all look."""
    (k, y, n), bands = place, words.begins[1, place[0], -1]
    count, number = words.row_counts[k, y], len(words.order)
    across, masks = room.across + 8 * (n * number + k) * room.bands, room.masks + 8 * k * room.bands
    table, left, right = (
        2 * (count * number + k) * words.width,
        words.inside[1, k, 0],
        words.inside[1, k, 1],
    )
    halves, gains = words.halves.ctypes.data + table, words.gains.ctypes.data + table
    left_over = room.left + 2 * n * words.width
    found, seen, floor = here
    rows = found, seen, left_over, floor, halves, gains, words.powers.ctypes.data + table
    apart = room.rows // 2, words.width, room.apart
    ends = left, right, words.width
    _settle(rows, ahead, noise, across, masks, bands, words.most, ends, apart)
    inner, quotient = (
        (found, seen, left_over, floor, gains),
        (words.inner[count, k, 0], words.inner[count, k, 1]),
    )
    span = left, right - left
    _settle_inside(inner, ahead, noise, across, bands, quotient, words.most, span, apart)


@compiled
def _show(arrays, words, left, k, y, row):
    """Make a picture of a row that was just found, by what is left of b."""
    width, count = words.shares.shape[1], words.row_counts[k, y]
    unit = np.float32(1 / words.most)
    gain = unit / np.float32(count) if count > 0 else _ZERO
    made = arrays.made.ctypes.data + 4 * row * width
    _ask_for(made + 4 * width, 4 * width)
    here = arrays.now.ctypes.data + 2 * row * words.width
    rows = made, words.shares.ctypes.data + 4 * k * width, left, here
    _to_light(rows, gain, unit, width)
