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
from layerfield.kernels.cells import NO_NETWORK, Network, relieve_picture, told
from layerfield.kernels.compiled import compiled
from layerfield.kernels.planes import back, forth
from layerfield.kernels.small_steps import (
    FIRST,
    Coarse,
    SmallSteps,
    small_steps,
    small_transforms,
    solve_low,
)
from layerfield.kernels.spectra import read_low, refuse_other_matrices, solve_rows
from layerfield.kernels.starts import Even, even_of, share_rim
from layerfield.kernels.strips import (
    NO_STRIPS,
    Sides,
    Strips,
    cut_columns,
    fill_strips,
    room_for_strips,
)
from layerfield.kernels.systems import (
    Steps,
    System,
    shares_of_data,
    shares_of_rest,
    shares_of_right,
    terms_of,
    terms_of_first,
)
from layerfield.kernels.threads import SPANS, parallel_address
from layerfield.kernels.three_passes import LARGE
from layerfield.kernels.transforms import Call, ForthAndBack, forth_and_back, transform_one

_STRIPS, _FORTH, _COARSE, _SOLVE, _BACK, _RELIEVE = range(6)  # what there is to do
_ONE = np.float32(1)
_AT_ONCE = 3  # planes that a step reads or writes: s, s of one step ago, and what it makes


class BalancedStart(NamedTuple):
    """What the first step of all begins with; see `LearnedAdmm`.

    Args:
        shares: of the layers whose band completes b; see `shared_start`.
        rest: the same.
        coarse: steps on larger pixels, which find what takes the place of low frequencies.
        window: shares of those, `[fy, fx]`.
        network: that changes s behind the first step, or none.
    """

    shares: Float[Tensor, "layer 1 ly lx"]
    rest: Float[Tensor, "*batch 1 c 1 1"]
    coarse: Coarse
    window: Float[Tensor, "fy fx"]
    network: Network | None


class _Known(NamedTuple):
    """What all steps have in common.

    Args:
        data: b of every plane; smaller ones lie in the top left corner.
        system: that they solve.
        sides: of the band.
        forth: the transform of a plane.
        back: the same from frequencies to pixels.
        none: no planes.
        strips: none.
        other: no low frequencies.
        window: of none.
    """

    data: np.ndarray
    system: System
    sides: Sides
    forth: Call
    back: Call
    none: np.ndarray
    strips: Strips
    other: np.ndarray
    window: np.ndarray


class _First(NamedTuple):
    """A `BalancedStart`.

    Args:
        is_here: whether there is one.
        even: layers whose band completes b.
        coarse: steps on larger pixels.
        other: low frequencies, `[item, layer, channel, fy, 2 fx]`.
        window: shares of those.
        network: what changes s behind it, or `NO_NETWORK`.
        bounds: that the network is told of.
        size: height and width of the layers.
    """

    is_here: bool
    even: Even
    coarse: SmallSteps
    other: np.ndarray
    window: np.ndarray
    network: Network
    bounds: tuple[np.float32, np.float32]
    size: tuple[int, int]


def steps_in_one_call(
    start: Float[Tensor, "*batch layer c ty tx"] | BalancedStart,
    before: Float[Tensor, "*batch layer c ty tx"] | None,
    data: Float[Tensor, "*batch layer c ly lx"],
    system: System,
    sides: Sides,
    constants: Steps,
) -> tuple[Tensor, Tensor | None] | None:
    """Return s after steps, and of one step before; or None where they are to be made one by one.

    Args:
        start: s, of single precision, on a processor; or what the first step of all begins with.
        before: s of one step ago, if there is one.
        data: b, without the band.
        system: to be solved, of both directions; the torus has an even width.
        sides: of the band.
        constants: of every step.

    Raises:
        ValueError: a system of another size, or larger data.
        MemoryError: there was none for what is in between.
    """
    first, shadow = (start, None) if isinstance(start, BalancedStart) else (None, start)
    *_, height, half = system.symbol.shape
    shape = (*data.shape[:-2], height, 2 * half - 2) if shadow is None else (*shadow.shape,)
    by, pairs, count = (-1, *shape[-4:]), (*shape[:-1], shape[-1] // 2), len(constants)
    refuse_other_matrices(system.symbol.shape, shape[-4], pairs, by_row=False)
    if parallel_address() is None or math.prod(shape[-2:]) >= LARGE:
        return None
    transforms = forth_and_back(pairs, by_row=False)
    low = None if first is None else small_transforms(_low(first, shape), first.coarse)
    if transforms is None or (first is not None and low is None):
        return None
    to_frequencies, to_pixels = transforms.calls(count)
    known = _Known(
        data=corners_of(data, shape),
        system=system,
        sides=sides,
        forth=to_frequencies,
        back=to_pixels,
        none=np.zeros((0, 0, 0), np.float32),
        strips=NO_STRIPS,
        other=np.zeros((1, shape[-4], 1, 0, 0), np.float32),
        window=np.zeros((0, 0), np.float32),
    )
    begun = _no_first(known) if first is None or low is None else _first(first, low, data, shape)
    rows = np.array(constants, np.float32)
    if before is None:  # nor has the second step, of what is behind a balanced start
        rows[: 2 if shadow is None else 1, -1] = 0
    made = [torch.empty(shape, dtype=torch.float32) for _ in range(min(count, _AT_ONCE))]
    own = tuple(made[n % len(made)].view(by).numpy() for n in range(_AT_ONCE))
    seen = own[0] if shadow is None else shadow.contiguous().view(by).numpy()
    ago = seen if before is None else before.contiguous().view(by).numpy()
    room, parts = room_for_strips(own[0].shape, sides), SPANS * torch.get_num_threads()
    solved = height // 2 + 1, (len(begun.window) + 1) // 2
    relieves = first is not None and first.network is not None
    tasks, needs = _tasks(own[0].shape[:3], *solved, count, parts, relieves)
    steps = own, seen, ago, room, rows, known, begun, tasks
    _make_steps.in_spans(*steps, count=len(tasks), numbers=math.prod(shape), needs=needs)
    last = made[(count - 2) % len(made)] if count > 1 else shadow
    return made[(count - 1) % len(made)], last


def _low(first: BalancedStart, shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape of the low frequencies of planes of such a shape."""
    return (*shape[:-2], *first.window.shape)


def _first(
    first: BalancedStart,
    transforms: ForthAndBack,
    data: Tensor,
    shape: tuple[int, ...],
) -> _First:
    """Return a balanced start for compiled loops."""
    system = first.coarse.system
    bounds = told((float(system.low), float(system.high)))
    *batch, number, channels, height, half = _low(first, shape)
    return _First(
        is_here=True,
        even=even_of(data, first.shares, first.rest),
        coarse=small_steps(first.coarse, transforms),
        other=np.zeros((math.prod(batch), number, channels, height, 2 * half), np.float32),
        window=first.window.numpy(),
        network=first.network or NO_NETWORK,
        bounds=(np.float32(bounds[0]), np.float32(bounds[1])),
        size=(data.shape[-2], data.shape[-1]),
    )


def _no_first(known: _Known) -> _First:
    """Return none."""
    shares, rows = np.zeros((0, 0, 0), np.float32), np.zeros((0, 0), np.float32)
    calls = known.forth, known.back
    steps = SmallSteps(known.system, rows, np.float32(1), NO_STRIPS, *calls)
    even, bounds = Even(shares, rows), (known.system.low, known.system.high)
    return _First(False, even, steps, known.other, known.window, NO_NETWORK, bounds, (0, 0))


@lru_cache(maxsize=16)
def _tasks(
    shape: tuple[int, int, int], rows: int, low: int, count: int, parts: int, relieves: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return tasks, `[n, (what, step, from, to)]`, and how many each of them needs done before it.

    Colours know nothing of each other, but for the matrices of every frequency, which are found
    once for all. So strips of one are found while planes of others are still transformed back, and
    steps on larger pixels are made beside the solution of frequencies that they leave alone.

    Args:
        shape: items, layers, and channels.
        rows: to be solved.
        low: so many of them, from the first on, wait in the first step for those on larger pixels.
        count: of steps.
        parts: of those rows.
        relieves: whether a network changes s behind the first step.
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

    def solve(step: int, begin: int, end: int, need: int) -> None:
        for row in range(begin, end, length):
            add(_SOLVE, step, row, min(row + length, end), need)

    shown = [0] * len(colours)
    for step in range(count):
        filled, seen = list[int](), list[int]()
        for colour in range(len(colours) + 1):
            if colour < len(colours):
                first, last = colours[colour][0], colours[colour][-1]
                filled.append(add(_STRIPS, step, first, last + 1, shown[colour]))
            if colour > 0:  # one behind, so that nobody waits for strips that were just begun
                for plane in colours[colour - 1]:
                    add(_FORTH, step, plane, plane + 1, filled[colour - 1])
                seen.append(len(tasks))
        waiting, found = low if step == 0 else 0, seen[-1]
        if waiting > 0:
            for colour, ready in enumerate(seen):
                found = add(_COARSE, step, colour, colour + 1, ready)
        solve(step, waiting, rows, seen[-1])
        solve(step, 0, waiting, found)
        solved = len(tasks)
        for colour, planes in enumerate(colours):
            for plane in planes:
                shown[colour] = add(_BACK, step, plane, plane + 1, solved)
        if relieves and step == 0:
            for colour, ready in enumerate(shown):
                shown[colour] = add(_RELIEVE, step, colour, colour + 1, ready)
    return np.array(tasks, np.int64), np.array(needs, np.int64)


@compiled
def _make_steps(own, shadow, before, room, constants, known, start, tasks, begin, end):
    """Do tasks from and to, on own planes in turns."""
    for task in range(begin, end):
        what, step, first, last = tasks[task, 0], tasks[task, 1], tasks[task, 2], tasks[task, 3]
        begins, row, made = start.is_here and step == 0, constants[step], own[step % len(own)]
        seen = own[(step - 1) % len(own)] if step > 0 else shadow
        ago = own[(step - 2) % len(own)] if step > 1 else (shadow if step > 0 else before)
        system, flat = known.system, (len(known.data), *made.shape[3:])
        planes, layers = made.reshape(flat), seen.reshape(flat)
        if what == _STRIPS:
            _find_strips(room, seen, known, start.even, begins, first, last)
        elif what == _FORTH:
            shares = shares_of_data() if begins else shares_of_right(row, system.weight)
            (below, beside, _), (down, across, weight) = room, known.sides
            strips = Strips(below, beside, down.start, across.start, weight * shares.other)
            right = Sum(layers, known.data, strips, shares, system.low, system.high)
            forth(planes, right, known.forth, first, last)
        elif what == _COARSE:
            _solve_coarsely(made, start, system.turns, first, last)
        elif what == _SOLVE:
            _solve(made, known, start, row, begins, first, last)
        elif what == _RELIEVE:
            number, channels = made.shape[1:3]
            size, bounds = start.size, start.bounds
            for colour in range(first, last):
                relieve_picture(planes, colour, number, channels, size, bounds, start.network)
        elif begins:
            for plane in range(first, last):
                transform_one(planes[plane], known.back)
        else:
            other = known.none if row[4] == 0 else ago.reshape(flat)
            rest = Sum(layers, other, known.strips, shares_of_rest(row), system.low, system.high)
            back(planes, rest, known.back, first, last)


@compiled
def _find_strips(room, layers, known, even, begins, begin, end):
    """Find those of a colour, from its first plane to its last, which one thread keeps at hand."""
    (below, beside, columns), (down, across, _) = room, known.sides
    channels, low, high = layers.shape[2], known.system.low, known.system.high
    planes = layers.reshape(len(below), *layers.shape[3:])
    for plane in range(begin, end, channels):
        if begins:
            share_rim(planes[plane], known.data, even, plane, down, across)
        cut_columns(columns, layers, across.start, low, high, plane, plane + 1)
    for plane in range(begin, end, channels):
        fill_strips(below, beside, layers, columns, down, across, low, high, plane, plane + 1)


@compiled
def _solve(spectrum, known, start, row, begins, begin, end):
    """Solve rows from and to."""
    _, number, _, height, width = spectrum.shape
    system, points = known.system, height * (width // 2)
    if begins:
        terms, other = terms_of_first(row, system, number, points), start.other
    else:
        terms, other = terms_of(row, system, points), known.other
    window = start.window if begins else known.window
    symbol, turns, by_row = system.symbol, system.turns, system.by_row
    solve_rows(spectrum, symbol, turns, terms, other, window, by_row, begin, end)


@compiled
def _solve_coarsely(spectrum, start, turns, begin, end):
    """Find what takes the place of low frequencies, of colours from and to."""
    _, number, channels, height, width = spectrum.shape
    for colour in range(begin, end):
        item, channel = divmod(colour, channels)
        for k in range(number):
            low, plane = start.other[item, k, channel], spectrum[item, k, channel]
            _cut_low(low, plane, start.window, turns, start.coarse.system.by_row)
    points = np.float32(height * (width // 2))
    solve_low(start.other, start.coarse, _ONE / points, begin, end)


@compiled
def _cut_low(low, plane, window, turns, by_row):
    """Find the share of low frequencies that is solved by itself."""
    height, width = plane.shape
    rows, twice = low.shape
    made, seen = low.reshape(1, rows, twice), plane.reshape(1, height, width)
    read_low(made, seen, turns, by_row, FIRST, rows)
    for y in range(rows):
        for x in range(twice):
            low[y, x] *= window[y, x // 2]
