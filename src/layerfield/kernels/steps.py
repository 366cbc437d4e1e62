"""Steps of ADMM on whole planes, several in one call.

Each is what `strips`, `planes` and `spectra` do one after the other. Between them the interpreter
would take a tenth of the time on planes that fit into the cache, and threads another tenth that
wait for the last of nine planes.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.blends import Sum, corners_of
from layerfield.kernels.compiled import compiled
from layerfield.kernels.planes import back, forth
from layerfield.kernels.spectra import refuse_other_matrices, solve_rows
from layerfield.kernels.strips import (
    NO_STRIPS,
    Sides,
    Strips,
    cut_columns,
    fill_strips,
    room_for_strips,
)
from layerfield.kernels.systems import Steps, System, shares_of_rest, shares_of_right, terms_of
from layerfield.kernels.threads import FEW, SPANS, parallel_address
from layerfield.kernels.three_passes import LARGE
from layerfield.kernels.transforms import Call, call_of, forth_and_back

_STRIPS, _FORTH, _SOLVE, _BACK = range(4)  # what there is to do
_AT_ONCE = 3  # planes that a step reads or writes: s, s of one step ago, and what it makes


class _Known(NamedTuple):
    """What all steps have in common.

    Args:
        data: b of every plane; smaller ones lie in the top left corner.
        system: that they solve.
        sides: of the band.
        forth: the transform of a plane.
        back: the same from frequencies to pixels.
        none: no planes.
        other: no low frequencies.
        window: of none.
        strips: none.
    """

    data: np.ndarray
    system: System
    sides: Sides
    forth: Call
    back: Call
    none: np.ndarray
    other: np.ndarray
    window: np.ndarray
    strips: Strips


def steps_in_one_call(
    shadow: Float[Tensor, "*batch layer c ty tx"],
    before: Float[Tensor, "*batch layer c ty tx"] | None,
    data: Float[Tensor, "*batch layer c ly lx"],
    system: System,
    sides: Sides,
    constants: Steps,
) -> tuple[Tensor, Tensor] | None:
    """Return s after steps, and of one step before; or None where they are to be made one by one.

    Args:
        shadow: s, of single precision, on a processor; the torus has an even width.
        before: s of one step ago, if there is one.
        data: b, without the band.
        system: to be solved, of both directions.
        sides: of the band.
        constants: of every step.

    Raises:
        ValueError: a system of another size, or larger data.
        MemoryError: there was none for what is in between.
    """
    number, channels, height, width = shadow.shape[-4:]
    pairs, count = (*shadow.shape[:-1], width // 2), len(constants)
    refuse_other_matrices(system.symbol.shape, number, pairs, by_row=False)
    if (address := parallel_address()) is None or height * width >= LARGE:
        return None
    if (transforms := forth_and_back(pairs, by_row=False, times=count)) is None:
        return None
    to_frequencies, to_pixels = map(call_of, transforms)
    rows = np.array(constants, np.float32)
    if before is None:
        before, rows[0, -1] = shadow, 0
    made = [torch.empty(shadow.shape) for _ in range(min(count, _AT_ONCE))]
    by = (-1, number, channels, height, width)
    given = [each.contiguous().view(by).numpy() for each in (shadow, before)]
    own = tuple(made[n % len(made)].view(by).numpy() for n in range(_AT_ONCE))
    known = _Known(
        data=corners_of(data, shadow.shape),
        system=system,
        sides=sides,
        forth=to_frequencies,
        back=to_pixels,
        none=np.zeros((0, 0, 0), np.float32),
        other=np.zeros((1, number, 1, 0, 0), np.float32),
        window=np.zeros((0, 0), np.float32),
        strips=NO_STRIPS,
    )
    threads = torch.get_num_threads() if shadow.numel() >= FEW else 1
    room = room_for_strips(own[0].shape, sides)
    shape, parts = own[0].shape[:3], SPANS * threads
    tasks, needs = _tasks(shape, height // 2 + 1, count, parts)
    steps = own, *given, *room, rows, known, tasks
    _do.in_order(*steps, needs=needs, threads=threads, address=address)
    last = made[(count - 2) % len(made)] if count > 1 else shadow
    return made[(count - 1) % len(made)], last


@lru_cache(maxsize=16)
def _tasks(
    shape: tuple[int, int, int], rows: int, count: int, parts: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return tasks, `[n, (what, step, from, to)]`, and what each of them needs.

    Colours know nothing of each other, but for the matrices of every frequency, which are found
    once for all. So strips of one are found while planes of others are still transformed back.

    Args:
        shape: items, layers, and channels.
        rows: to be solved.
        count: of steps.
        parts: of those rows.
    """
    items, number, channels = shape
    groups, length = items * channels, math.ceil(rows / parts)
    tasks, needs, shown = list[tuple[int, int, int, int]](), list[int](), [0] * groups
    for step in range(count):
        filled = list[int]()
        for group in range(groups + 1):
            if group < groups:
                tasks.append((_STRIPS, step, group, group + 1))
                needs.append(shown[group])
                filled.append(len(tasks))
            if group > 0:  # one behind, so that nobody waits for the strips that were just begun
                for plane in _planes(group - 1, number, channels):
                    tasks.append((_FORTH, step, plane, plane + 1))
                    needs.append(filled[group - 1])
        here = len(tasks)
        for begin in range(0, rows, length):
            tasks.append((_SOLVE, step, begin, min(begin + length, rows)))
            needs.append(here)
        here = len(tasks)
        for group in range(groups):
            for plane in _planes(group, number, channels):
                tasks.append((_BACK, step, plane, plane + 1))
                needs.append(here)
            shown[group] = len(tasks)
    return np.array(tasks, np.int64), np.array(needs, np.int64)


def _planes(group: int, number: int, channels: int) -> range:
    """Return those of one colour of one item: `[item, layer, channel]`, one after the other."""
    item, channel = divmod(group, channels)
    first = item * number * channels + channel
    return range(first, first + number * channels, channels)


@compiled
def _do(own, shadow, before, below, beside, columns, constants, known, tasks, task):
    """One of `tasks`, on own planes in turns."""
    what, step, begin, end = tasks[task, 0], tasks[task, 1], tasks[task, 2], tasks[task, 3]
    number, channels, height, width = shadow.shape[1:]
    system, row, (down, across, weight) = known.system, constants[step], known.sides
    flat, low, high = (len(below), height, width), system.low, system.high
    made = own[step % len(own)]
    seen = own[(step - 1) % len(own)] if step > 0 else shadow
    ago = own[(step - 2) % len(own)] if step > 1 else (shadow if step > 0 else before)
    planes, layers = made.reshape(flat), seen.reshape(flat)
    if what == _STRIPS:
        item, channel = divmod(begin, channels)
        first = item * number * channels + channel
        for plane in range(first, first + number * channels, channels):
            cut_columns(columns, seen, across.start, low, high, plane, plane + 1)
        for plane in range(first, first + number * channels, channels):
            fill_strips(below, beside, seen, columns, down, across, low, high, plane, plane + 1)
    elif what == _FORTH:
        shares = shares_of_right(row, system.weight)
        strips = Strips(below, beside, down.start, across.start, weight * shares.other)
        forth(planes, Sum(layers, known.data, strips, shares, low, high), known.forth, begin, end)
    elif what == _SOLVE:
        terms = terms_of(row, system, height * (width // 2))
        symbol, turns, by_row = system.symbol, system.turns, system.by_row
        solve_rows(made, symbol, turns, terms, known.other, known.window, by_row, begin, end)
    else:
        other = known.none if row[4] == 0 else ago.reshape(flat)
        rest = Sum(layers, other, known.strips, shares_of_rest(row), low, high)
        back(planes, rest, known.back, begin, end)
