"""Steps of ADMM on whole planes, several in one call.

Each is what `strips`, `planes` and `spectra` do one after the other; between them the interpreter
would take a tenth of the time on planes that fit into the cache.
"""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.blends import Sum, corners_of
from layerfield.kernels.compiled import compiled, spread
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
from layerfield.kernels.threads import FEW, parallel_address
from layerfield.kernels.three_passes import LARGE
from layerfield.kernels.transforms import Call, call_of, forth_and_back

_AT_ONCE = 3  # planes that a step reads or writes: s, s of one step ago, and what it makes


class _Team(NamedTuple):
    """How many threads, and where what calls them is."""

    threads: int
    address: int


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
    if _make_steps(own, *given, *room, rows, known, _Team(threads, address)):
        raise MemoryError("there is not enough memory for a compiled loop")
    last = made[(count - 2) % len(made)] if count > 1 else shadow
    return made[(count - 1) % len(made)], last


_cut = spread(cut_columns)
_fill = spread(fill_strips)
_forth = spread(forth)
_solve = spread(solve_rows)
_back = spread(back)


@compiled
def _make_steps(own, shadow, before, below, beside, columns, constants, known, team):
    """Fill own planes in turns; return whether memory was short."""
    threads, address = team.threads, team.address
    items, number, channels, height, width = shadow.shape
    planes, system, failed = items * number * channels, known.system, 0
    flat, low, high = (planes, height, width), system.low, system.high
    down, across, weight = known.sides
    for n in range(len(constants)):
        made, row = own[n % len(own)], constants[n]
        seen, work = shadow.reshape(flat), made.reshape(flat)
        cut = (columns, shadow, across.start, low, high)
        failed += _cut(cut, planes, threads, address)
        filled = (below, beside, shadow, columns, down, across, low, high)
        failed += _fill(filled, planes, threads, address)
        shares = shares_of_right(row, system.weight)
        strips = Strips(below, beside, down.start, across.start, weight * shares.other)
        right = Sum(seen, known.data, strips, shares, low, high)
        failed += _forth((work, right, known.forth), planes, threads, address)
        terms = terms_of(row, system, height * (width // 2))
        pairs = (made, system.symbol, system.turns, terms, known.other, known.window, system.by_row)
        failed += _solve(pairs, height // 2 + 1, threads, address)
        other = known.none if row[4] == 0 else before.reshape(flat)
        rest = Sum(seen, other, known.strips, shares_of_rest(row), low, high)
        failed += _back((work, rest, known.back), planes, threads, address)
        shadow, before = made, shadow
        if failed:
            break
    return failed > 0
