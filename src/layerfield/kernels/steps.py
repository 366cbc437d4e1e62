"""Steps of ADMM on whole planes, several in one call.

Each is what `strips`, `planes` and `spectra` do one after the other. Between them the interpreter
would take a tenth of the time on planes that fit into the cache, and threads that wait for the last
of nine planes a twentieth.
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
from layerfield.kernels.threads import SPANS, parallel_address
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
    if parallel_address() is None or height * width >= LARGE:
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
    room, shape = room_for_strips(own[0].shape, sides), own[0].shape[:3]
    tasks, needs = _tasks(shape, height // 2 + 1, count, SPANS * torch.get_num_threads())
    steps = own, *given, room, rows, known, tasks
    _make_steps.in_spans(*steps, count=len(tasks), numbers=shadow.numel(), needs=needs)
    last = made[(count - 2) % len(made)] if count > 1 else shadow
    return made[(count - 1) % len(made)], last


@lru_cache(maxsize=16)
def _tasks(
    shape: tuple[int, int, int], rows: int, count: int, parts: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return tasks, `[n, (what, step, from, to)]`, and how many each of them needs done before it.

    Colours know nothing of each other, but for the matrices of every frequency, which are found
    once for all. So strips of one are found while planes of others are still transformed back.

    Args:
        shape: items, layers, and channels.
        rows: to be solved.
        count: of steps.
        parts: of those rows.
    """
    items, number, channels = shape
    places = np.arange(items * number * channels).reshape(shape)
    colours = places.transpose(0, 2, 1).reshape(-1, number).tolist()  # planes of each
    length = math.ceil(rows / parts)
    tasks, needs = list[tuple[int, int, int, int]](), list[int]()

    def add(what: int, step: int, begin: int, end: int, need: int) -> int:
        tasks.append((what, step, begin, end))
        needs.append(need)
        return len(tasks)

    shown = [0] * len(colours)
    for step in range(count):
        filled = list[int]()
        for colour in range(len(colours) + 1):
            if colour < len(colours):
                first, last = colours[colour][0], colours[colour][-1]
                filled.append(add(_STRIPS, step, first, last + 1, shown[colour]))
            if colour > 0:  # one behind, so that nobody waits for strips that were just begun
                for plane in colours[colour - 1]:
                    add(_FORTH, step, plane, plane + 1, filled[colour - 1])
        transformed = len(tasks)
        for begin in range(0, rows, length):
            add(_SOLVE, step, begin, min(begin + length, rows), transformed)
        solved = len(tasks)
        for colour, planes in enumerate(colours):
            for plane in planes:
                shown[colour] = add(_BACK, step, plane, plane + 1, solved)
    return np.array(tasks, np.int64), np.array(needs, np.int64)


@compiled
def _make_steps(own, shadow, before, room, constants, known, tasks, begin, end):
    """Do tasks from and to, on own planes in turns."""
    below, beside, columns = room
    for task in range(begin, end):
        what, step, first, last = tasks[task, 0], tasks[task, 1], tasks[task, 2], tasks[task, 3]
        made = own[step % len(own)]
        seen = own[(step - 1) % len(own)] if step > 0 else shadow
        ago = own[(step - 2) % len(own)] if step > 1 else (shadow if step > 0 else before)
        system, row, (down, across, weight) = known.system, constants[step], known.sides
        (channels, height, width), low, high = shadow.shape[2:], system.low, system.high
        flat = len(below), height, width
        planes, layers = made.reshape(flat), seen.reshape(flat)
        if what == _STRIPS:  # by one thread, which has their columns in its cache
            for plane in range(first, last, channels):
                cut_columns(columns, seen, across.start, low, high, plane, plane + 1)
            for plane in range(first, last, channels):
                fill_strips(below, beside, seen, columns, down, across, low, high, plane, plane + 1)
        elif what == _FORTH:
            shares = shares_of_right(row, system.weight)
            strips = Strips(below, beside, down.start, across.start, weight * shares.other)
            right = Sum(layers, known.data, strips, shares, low, high)
            forth(planes, right, known.forth, first, last)
        elif what == _SOLVE:
            terms = terms_of(row, system, height * (width // 2))
            symbol, turns, by_row = system.symbol, system.turns, system.by_row
            other, window = known.other, known.window
            solve_rows(made, symbol, turns, terms, other, window, by_row, first, last)
        else:
            other = known.none if row[4] == 0 else ago.reshape(flat)
            rest = Sum(layers, other, known.strips, shares_of_rest(row), low, high)
            back(planes, rest, known.back, first, last)
