"""Steps of ADMM on planes so small that a whole run of them stays in the cache."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.blends import Shares, Sum, blend_row
from layerfield.kernels.compiled import compiled
from layerfield.kernels.spectra import Terms, Turns, solve_rows, turns_of
from layerfield.kernels.strips import NO_STRIPS, Strips
from layerfield.kernels.transforms import Call, call_of, plane_transform, transform_one

_SMALL = 1 << 16  # pixels of a plane; from there on more threads are worth more than the cache
_NONE = np.zeros((0, 0, 0), np.float32)
_ZERO: Any = np.float32(0)  # a number as all others are: others would be double


class _Known(NamedTuple):
    """What all steps of all colours have in common.

    Args:
        symbol: G(f).
        turns: of the spectrum.
        weight: W.
        pull: of the term for frequency zero.
        low: of the bounds.
        high: of the bounds.
        strips: there are none.
        forth: the transform of a plane.
        back: the same from frequencies to pixels.
        by_row: whether rows are transformed by themselves.
    """

    symbol: np.ndarray
    turns: Turns
    weight: np.float32
    pull: np.float32
    low: np.float32
    high: np.float32
    strips: Strips
    forth: Call
    back: Call
    by_row: bool


def steps_at_once(
    data: Float[Tensor, "*batch layer c ty tx"],
    symbol: Float[Tensor, "layer layer fy fx"],
    by_row: bool,
    weight: float,
    balance: float,
    bounds: tuple[float, float],
    constants: Sequence[tuple[float, float, float, float, float]],
) -> Float[Tensor, "*batch layer c ty tx"] | None:
    """Return s after steps from b / (W K), or None where making them one by one is no slower.

    Colours know nothing of each other: each is the task of one thread, from the first step to the
    last.

    Args:
        data: b, of single precision, on a processor; the torus has an even width.
        symbol: G(f), of a single row where all are transformed by themselves.
        by_row: whether they are.
        weight: W, of all views together.
        balance: share of it, of the term for frequency zero.
        bounds: of layer pixels.
        constants: of every step, as of `LearnedAdmm`: penalty, relaxation, trust, kept, momentum.
    """
    *batch, number, channels, height, width = data.shape
    if height * width >= _SMALL:
        return None
    pairs = (*data.shape[:-1], width // 2)
    forth = plane_transform(pairs, by_row, back=False, times=len(constants))
    back = plane_transform(pairs, by_row, back=True, times=len(constants))
    if forth is None or back is None:
        return None
    seen = data.transpose(-4, -3).contiguous().view(-1, number, height, width)
    made = torch.empty_like(seen)
    pull = 0 if by_row else balance * weight
    known = _Known(
        symbol=symbol.numpy(),
        turns=turns_of(width),
        weight=np.float32(weight),
        pull=np.float32(pull),
        low=np.float32(bounds[0]),
        high=np.float32(bounds[1]),
        strips=NO_STRIPS,
        forth=call_of(forth),
        back=call_of(back),
        by_row=by_row,
    )
    given = (made.numpy(), seen.numpy(), np.array(constants, np.float32), known)
    _make_steps.in_spans(*given, count=len(seen), numbers=len(constants) * made.numel())
    return made.view(*batch, channels, number, height, width).transpose(-4, -3)


@compiled
def _make_steps(result, data, constants, known, begin, end):
    """All layers of one colour after the other, from and to."""
    (number, height, width), by_row = data.shape[1:], known.by_row
    low, high, strips = known.low, known.high, known.strips
    points = width // 2 * (1 if by_row else height)
    rows = height if by_row else height // 2 + 1
    window = np.zeros((0, 0), data.dtype)
    other = np.zeros((1, number, 1, 0, 0), data.dtype)
    for place in range(begin, end):
        seen = data[place]
        shadow, before, work = np.empty_like(seen), np.empty_like(seen), np.empty_like(seen)
        share = Shares(_ZERO, 1 / (known.weight * np.float32(number)), _ZERO)
        start = Sum(seen, _NONE, strips, share, low, high)
        for k in range(number):
            for y in range(height):
                blend_row(shadow[k, y], start, k, y, True)
        for n in range(len(constants)):
            penalty, a, trust, kept, momentum = constants[n]
            rho = penalty * known.weight
            shares = Shares(1 + trust, -trust, 1 / rho)
            right = Sum(shadow, seen, strips, shares, low, high)
            for k in range(number):
                for y in range(height):
                    blend_row(work[k, y], right, k, y, True)
                transform_one(work[k], known.forth)
            terms = Terms(rho, known.pull, a * rho / np.float32(points), _ZERO)
            spectrum, symbol = work.reshape(1, number, 1, height, width), known.symbol
            solve_rows(spectrum, symbol, known.turns, terms, other, window, by_row, 0, rows)
            again = _ZERO if n == 0 else momentum
            shares = Shares(1 - a - kept, kept + again, -again)
            rest = Sum(shadow, _NONE if n == 0 else before, strips, shares, low, high)
            for k in range(number):
                transform_one(work[k], known.back)
                for y in range(height):
                    blend_row(work[k, y], rest, k, y, False)
            shadow, before, work = work, shadow, before
        result[place] = shadow
