"""Steps of ADMM on planes so small that a whole run of them stays in the cache."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.blends import Sum, blend_row
from layerfield.kernels.compiled import compiled
from layerfield.kernels.spectra import refuse_other_matrices, solve_rows
from layerfield.kernels.strips import NO_STRIPS, Strips
from layerfield.kernels.systems import (
    Steps,
    System,
    shares_of_rest,
    shares_of_right,
    shares_of_start,
    terms_of,
)
from layerfield.kernels.transforms import Call, call_of, forth_and_back, transform_one

_SMALL = 1 << 16  # pixels of a plane; from there on more threads are worth more than the cache
_NONE = np.zeros((0, 0, 0), np.float32)


class _Known(NamedTuple):
    """What all steps of all colours have in common.

    Args:
        system: that they solve.
        strips: there are none.
        forth: the transform of a plane.
        back: the same from frequencies to pixels.
    """

    system: System
    strips: Strips
    forth: Call
    back: Call


def steps_at_once(
    data: Float[Tensor, "*batch layer c ty tx"], system: System, constants: Steps
) -> Float[Tensor, "*batch layer c ty tx"] | None:
    """Return s after steps from b / (W K), or None where making them one by one is no slower.

    Colours know nothing of each other: each is the task of one thread, from the first step to the
    last.

    Args:
        data: b, of single precision, on a processor; the torus has an even width.
        system: to be solved.
        constants: of every step.

    Raises:
        ValueError: a system of another size.
    """
    *batch, number, channels, height, width = data.shape
    if height * width >= _SMALL:
        return None
    by_row, pairs = system.by_row, (*data.shape[:-1], width // 2)
    refuse_other_matrices(system.symbol.shape, number, pairs, by_row)
    if (transforms := forth_and_back(pairs, by_row, len(constants))) is None:
        return None
    seen = data.transpose(-4, -3).contiguous().view(-1, number, height, width)
    made = torch.empty_like(seen)
    known = _Known(system, NO_STRIPS, *map(call_of, transforms))
    rows = np.array(constants, np.float32)
    rows[0, -1] = 0  # there is no s of one step ago
    given = (made.numpy(), seen.numpy(), rows, known)
    _make_steps.in_spans(*given, count=len(seen), numbers=len(constants) * made.numel())
    return made.view(*batch, channels, number, height, width).transpose(-4, -3)


@compiled
def _make_steps(result, data, constants, known, begin, end):
    """All layers of one colour after the other, from and to."""
    (number, height, width), system, strips = data.shape[1:], known.system, known.strips
    by_row, low, high = system.by_row, system.low, system.high
    points = width // 2 * (1 if by_row else height)
    rows = height if by_row else height // 2 + 1
    window = np.zeros((0, 0), data.dtype)
    other = np.zeros((1, number, 1, 0, 0), data.dtype)
    for place in range(begin, end):
        seen = data[place]
        shadow, before, work = np.empty_like(seen), np.empty_like(seen), np.empty_like(seen)
        start = Sum(seen, _NONE, strips, shares_of_start(system.weight, number), low, high)
        for k in range(number):
            for y in range(height):
                blend_row(shadow[k, y], start, k, y, True)
        for n in range(len(constants)):
            right_shares = shares_of_right(constants[n], system.weight)
            right = Sum(shadow, seen, strips, right_shares, low, high)
            for k in range(number):
                for y in range(height):
                    blend_row(work[k, y], right, k, y, True)
                transform_one(work[k], known.forth)
            spectrum = work.reshape(1, number, 1, height, width)
            symbol, turns = system.symbol, system.turns
            terms = terms_of(constants[n], system, points)
            solve_rows(spectrum, symbol, turns, terms, other, window, by_row, 0, rows)
            rest_shares = shares_of_rest(constants[n])
            ago = _NONE if constants[n, 4] == 0 else before
            rest = Sum(shadow, ago, strips, rest_shares, low, high)
            for k in range(number):
                transform_one(work[k], known.back)
                for y in range(height):
                    blend_row(work[k, y], rest, k, y, False)
            shadow, before, work = work, shadow, before
        result[place] = shadow
