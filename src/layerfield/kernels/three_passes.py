"""Planes multiplied by (G + rho I)^-1 in three passes over memory.

Rows are summed up and transformed, eight at a time; then columns are transformed, multiplied, and
transformed back while those of all layers are in the cache; then rows are transformed back, and
summed up with what else there is. What is between passes is X, the spectrum of real rows, in lane
groups (see `lanes`): frequencies 0 to W / 2, eight at a time from the first row to the last, so
that columns are read as they lie in memory. Rows are asked for while those before them are
transformed, and what is written is not fetched first.

Where something else takes the place of low frequencies, their columns are transformed before, and
what is found of them is put in when they are multiplied.

Planes one after the other, as `planes` and `spectra` have them, go over memory twice as often.
Where they fit into the cache that costs nothing.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.blends import NOTHING, Blend, blend_row, planes_of, shows_layers
from layerfield.kernels.compiled import compiled, native
from layerfield.kernels.fourier import transform_groups, turns_of_length
from layerfield.kernels.inverses import Terms, invert
from layerfield.kernels.radices import LANES, radices_of
from layerfield.kernels.spectra import numbers_of, refuse_other_matrices, row_in
from layerfield.kernels.symbols import Symbol, row_of
from layerfield.kernels.transforms import note_transform

_GROUP = 2 * LANES
_ONE = np.float32(1)
_LINE = 4 * _GROUP  # bytes that memory is fetched in
_APART = 1  # times eight rows between columns: in powers of two, caches put them in one place
LARGE = 1 << 20  # pixels of a plane from which on memory is what takes time


class _Plan(NamedTuple):
    """Of planes of one size.

    Args:
        across: radices of rows, as pairs.
        down: of columns.
        turns_across: cos and sin of 2 pi t / n of rows, as pairs.
        turns_down: of columns.
        turns: of rows as they are.
    """

    across: np.ndarray
    down: np.ndarray
    turns_across: np.ndarray
    turns_down: np.ndarray
    turns: np.ndarray


class LowApart(NamedTuple):
    """Low frequencies that are solved by themselves.

    Args:
        window: shares of those, `[fy, fx]` as of a smaller torus; its highest do not count.
        solve: returns, of the spectrum of these shares, what takes their place.
    """

    window: Float[Tensor, "fy fx"]
    solve: Callable[[Tensor], Tensor]


class _Low(NamedTuple):
    """What was found of low frequencies.

    Args:
        spectrum: `[item, layer, channel, fy, 2 fx]`.
        window: shares of what it replaces, `[fy, fx]`.
        groups: so many groups of columns, from the first on, have been transformed.
    """

    spectrum: np.ndarray
    window: np.ndarray
    groups: int


def solved_in_three_passes(
    planes: Blend,
    symbol: Symbol,
    terms: Terms,
    added: Blend | None = None,
    apart: LowApart | None = None,
) -> Float[Tensor, "*batch layer c ty tx"] | None:
    """Return planes times g (G + rho I)^-1 + k I and what is added, or None where that is no use.

    Rows and columns both are transformed.

    Args:
        planes: of layers and their channels, of single precision, on a processor.
        symbol: G(f).
        terms: rho, b, g and k; see `spectra`.
        added: to what comes out.
        apart: what is solved by itself.

    Raises:
        ValueError: matrices of another size.
    """
    *batch, number, channels, height, width = planes.shadow.shape
    pairs = (*planes.shadow.shape[:-1], width // 2)
    refuse_other_matrices(symbol.shape, number, pairs, by_row=False)
    plan = _plan(height, width)
    if height * width < LARGE or plan is None:
        return None
    groups = math.ceil((width // 2 + 1) / LANES)
    items, tiles = math.prod(batch), math.ceil(height / LANES)
    room = (items, number, channels, groups, (tiles + _APART) * LANES * _GROUP)
    work = torch.empty(room, dtype=torch.float32).numpy()
    if not _is_aligned(work):
        return None
    for back in (False, True):
        note_transform(pairs, by_row=False, back=back)
    count, numbers = items * number * channels * tiles, planes.shadow.numel()
    flat, factor = work.reshape(-1, *work.shape[-2:]), 2 / (height * width)
    _rows_forth.in_spans(flat, planes.sum(), plan, count=count, numbers=numbers)
    low = _no_low(work) if apart is None else _found_low(work, apart, plan, batch, factor)
    kept, gain = terms.kept * factor, terms.gain * factor
    given = Terms._make(map(np.float32, terms._replace(gain=gain, kept=kept)))
    count_solved = groups * items * channels
    each = (0,) * number  # how many there are is known when loops are compiled
    solved = work, symbol, given, plan, low, each
    _columns_solved.in_spans(*solved, count=count_solved, numbers=numbers)
    result = torch.empty(planes.shadow.shape, dtype=torch.float32)
    made, rest = planes_of(result), NOTHING if added is None else added.sum()
    _rows_back.in_spans(made, flat, rest, plan, _is_aligned(made), count=count, numbers=numbers)
    return result


def _no_low(work: np.ndarray) -> _Low:
    nothing = np.zeros((*work.shape[:3], 0, 0), np.float32)
    return _Low(nothing, nothing[0, 0, 0], 0)


def _found_low(
    work: np.ndarray, apart: LowApart, plan: _Plan, batch: list[int], factor: float
) -> _Low:
    """Return what takes the place of low frequencies, whose columns are transformed.

    Args:
        work: rows that are.
        apart: what is solved by itself.
        plan: of the planes.
        batch: of them.
        factor: what to multiply it by.
    """
    (rows, columns), planes = apart.window.shape, math.prod(work.shape[:3])
    groups, window = math.ceil((columns - 1) / LANES), apart.window.contiguous().numpy()
    flat, numbers = work.reshape(planes, *work.shape[3:]), planes * groups * work.shape[-1]
    _columns_forth.in_spans(flat, plan, groups, count=planes * groups, numbers=numbers)
    seen = torch.empty(*batch, *work.shape[1:3], rows, columns, dtype=torch.complex64)
    made = numbers_of(seen)
    _read_low.in_spans(made, flat, window, plan, count=planes * rows, numbers=made.size)
    found = numbers_of(apart.solve(seen) * factor, *work.shape[1:3])
    return _Low(found, window, groups)


def _is_aligned(array: np.ndarray) -> bool:
    """Whether all rows of contiguous single precision begin with a line of the cache."""
    return array.ctypes.data % _LINE == 0 and 4 * array.shape[-1] % _LINE == 0


@lru_cache(maxsize=16)
def _plan(height: int, width: int) -> _Plan | None:
    across, down = radices_of(width // 2), radices_of(height)
    if width % 2 != 0 or across is None or down is None:
        return None
    return _Plan(across, down, *(turns_of_length(n) for n in (width // 2, height, width)))


_ask_for = native("layerfield.kernels.ahead", "ask_for")
_take_rows = native("layerfield.kernels.lanes", "take_rows")
_put_rows = native("layerfield.kernels.lanes", "put_rows")
_take_groups = native("layerfield.kernels.lanes", "take_groups")
_put_groups = native("layerfield.kernels.lanes", "put_groups")
_put_past_cache = native("layerfield.kernels.lanes", "put_past_cache")
_settle = native("layerfield.kernels.lanes", "settle")
_take_lanes = native("layerfield.kernels.lanes", "take_lanes")
_multiply_groups = native("layerfield.kernels.lanes", "multiply_groups")
_swap_group = native("layerfield.kernels.lanes", "swap_group")
_pairs_to_spectrum = native("layerfield.kernels.lanes", "pairs_to_spectrum")
_spectrum_to_pairs = native("layerfield.kernels.lanes", "spectrum_to_pairs")


@compiled
def _rows_forth(work, known, plan, begin, end):
    """Eight rows at a time, from and to: of all planes, one after the other."""
    height, half = known.shadow.shape[1], known.shadow.shape[2] // 2
    columns, step = work.shape[1], work.shape[2]
    tiles, groups = (height + LANES - 1) // LANES, (half + LANES - 1) // LANES
    rows = np.zeros((LANES + 1, 2 * half), np.float32)  # the last group may reach past a row
    length = columns * LANES * _GROUP
    one, other = np.zeros(length, np.float32), np.zeros(length, np.float32)
    for number in range(begin, end):
        plane, tile = divmod(number, tiles)
        for y in range(min(LANES, height - tile * LANES)):
            blend_row(rows[y], known, plane, tile * LANES + y, True)
        seen, made = rows.reshape(-1), work[plane].reshape(-1)
        for group in range(groups):
            place = group * _GROUP
            _take_rows(seen, place, 2 * half, one, place * LANES, False)
        if number + 1 < end:
            _ask_for_rows(known, number + 1, tiles)
        turns = plan.turns_across
        is_in_one = transform_groups(plan.across, half, one, 0, _GROUP, other, one, turns)
        values = one if is_in_one else other
        for x in range(half // 2 + 1):
            near, far = x * _GROUP, (half - x) * _GROUP
            _pairs_to_spectrum(values, near, far if x > 0 else 0, far, plan.turns, x)
        for column in range(columns):
            place = column * LANES * _GROUP
            there = column * step + tile * LANES * _GROUP
            _put_groups(values, place, made, there)
    _settle()


@compiled
def _rows_back(planes, work, known, plan, is_aligned, begin, end):
    """Eight rows at a time, from and to: of all planes, one after the other."""
    height, half = planes.shape[1], planes.shape[2] // 2
    columns, step = work.shape[1], work.shape[2]
    tiles, groups = (height + LANES - 1) // LANES, (half + LANES - 1) // LANES
    rows = np.zeros((LANES + 1, 2 * half), np.float32)  # the last group may reach past a row
    length = columns * LANES * _GROUP
    one, other = np.zeros(length, np.float32), np.zeros(length, np.float32)
    for number in range(begin, end):
        plane, tile = divmod(number, tiles)
        seen, made = work[plane].reshape(-1), rows.reshape(-1)
        for column in range(columns):
            place = column * LANES * _GROUP
            there = column * step + tile * LANES * _GROUP
            _take_groups(seen, there, _GROUP, one, place)
        if number + 1 < end:
            _ask_for_groups(work, number + 1, tiles)
            _ask_for_rows(known, number + 1, tiles)
        for x in range(half // 2 + 1):
            _spectrum_to_pairs(one, x * _GROUP, (half - x) * _GROUP, plan.turns, x)
        turns = plan.turns_across
        is_in_one = transform_groups(plan.across, half, one, 0, _GROUP, other, one, turns)
        values = one if is_in_one else other
        for group in range(groups - 1, -1, -1):  # and is put before the rows that it reaches into
            place = group * _GROUP
            _put_rows(values, place * LANES, made, place, 2 * half, True, False)
        for y in range(min(LANES, height - tile * LANES)):
            row = planes[plane, tile * LANES + y]
            blend_row(rows[y], known, plane, tile * LANES + y, False)
            if is_aligned:
                _put_past_cache(rows[y], row, 2 * half)
            else:
                _copy(row, rows[y])
    _settle()


@compiled
def _ask_for_groups(work, number, tiles):
    """Those of eight rows."""
    plane, tile = divmod(number, tiles)
    begin = tile * LANES * _GROUP
    for column in range(work.shape[1]):
        _ask_for(work[plane, column, begin : begin + LANES * _GROUP])


@compiled
def _ask_for_rows(known, number, tiles):
    """Eight of what is added up."""
    plane, tile = divmod(number, tiles)
    for y in range(tile * LANES, (tile + 1) * LANES):
        if y < known.shadow.shape[1] and shows_layers(known):
            _ask_for(known.shadow[plane, y])
        if y < known.other.shape[1]:
            _ask_for(known.other[plane, y])


@compiled
def _columns_forth(work, plan, groups, begin, end):
    """Eight columns at a time, from and to: the first groups of all planes, one after the other."""
    height = len(plan.turns_down) // 2
    other = np.zeros(height * _GROUP, np.float32)
    for number in range(begin, end):
        plane, group = divmod(number, groups)
        made, turns = work[plane, group], plan.turns_down
        if not transform_groups(plan.down, height, made, 0, _GROUP, other, made, turns):
            _copy(made, other)


@compiled
def _read_low(result, work, window, plan, begin, end):
    """Rows of all planes, from and to: shares of low frequencies, as those of a smaller torus."""
    rows, height = result.shape[1], len(plan.turns_down) // 2
    for number in range(begin, end):
        plane, row = divmod(number, rows)
        made, place = result[plane, row], row_in(height, row, rows) * _GROUP
        made[:] = 0
        if 2 * row != rows:
            for x in range(window.shape[1] - 1):
                group, lane = divmod(x, LANES)
                seen, share = work[plane, group], window[row, x]
                made[2 * x] = share * seen[place + lane]
                made[2 * x + 1] = share * seen[place + LANES + lane]


@compiled
def _replace_low(made, height, low, item, k, channel, tile):
    """Put what was found in the place of shares of a group of columns; real parts come last."""
    other, window, first = low.spectrum[item, k, channel], low.window, tile * LANES
    rows, lanes = len(window), min(LANES, window.shape[1] - 1 - first)
    for row in range(rows):
        if 2 * row != rows:
            place = row_in(height, row, rows) * _GROUP
            for lane in range(lanes):
                x = first + lane
                rest = _ONE - window[row, x]
                imaginary, real = made[place + lane], made[place + LANES + lane]
                made[place + lane] = rest * imaginary + other[row, 2 * x + 1]
                made[place + LANES + lane] = rest * real + other[row, 2 * x]


@compiled
def _columns_solved(work, symbol, terms, plan, low, each, begin, end):
    """Eight columns at a time, from and to: of all layers of one channel, one after the other."""
    items, number, channels = work.shape[:3]
    height = symbol.down.shape[2]
    inverse = np.zeros((number, number, height * LANES), np.float32)
    seen = np.zeros((number, height * _GROUP), np.float32)
    one, other = np.zeros(height * _GROUP, np.float32), np.zeros(height * _GROUP, np.float32)
    entries, values = inverse.reshape(-1), seen.reshape(-1)
    last, turns = -1, plan.turns_down
    for place in range(begin, end):
        tile, rest = divmod(place, items * channels)
        item, channel = divmod(rest, channels)
        if tile != last:
            for k in range(number):
                for m in range(k, number):
                    _read_columns(inverse[k, m], symbol, k, m, tile * LANES)
            invert(inverse, terms, tile == 0)
            last = tile
        for k in range(number):
            there, made = work[item, k, channel, tile], seen[k]
            if tile < low.groups:
                _copy(made, there)
            elif not transform_groups(plan.down, height, there, 0, _GROUP, other, made, turns):
                _copy(made, other)
        for y in range(height):
            group, stride = y * _GROUP, height * _GROUP
            _multiply_groups(each, entries, y * LANES, height * LANES, values, group, stride)
        for k in range(number):
            there, given = work[item, k, channel, tile], seen[k]
            if tile < low.groups:
                _replace_low(given, height, low, item, k, channel, tile)
            is_in_one = transform_groups(plan.down, height, given, 0, _GROUP, other, one, turns)
            made = one if is_in_one else other
            for y in range(height):
                _swap_group(made, y * _GROUP, there, y * _GROUP)


@compiled
def _read_columns(entry, symbol, k, m, first):
    """Frequencies past the highest do not count."""
    columns = symbol.across.shape[2]
    for y in range(symbol.down.shape[2]):
        row, factor = row_of(symbol, k, m, y)
        if first + LANES <= columns:
            _take_lanes(row, first, factor, entry, y * LANES)
        else:
            for x in range(columns - first):
                entry[y * LANES + x] = factor * row[first + x]


@compiled
def _copy(row, other):
    for x in range(len(row)):
        row[x] = other[x]
