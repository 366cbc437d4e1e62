"""Steps of ADMM on planes so small that a whole run of them stays in the cache."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex
from torch import Tensor

from layerfield.kernels.blends import Sum, blend_row
from layerfield.kernels.compiled import compiled
from layerfield.kernels.spectra import (
    numbers_of,
    put_low,
    read_low,
    refuse_other_matrices,
    solve_rows,
)
from layerfield.kernels.strips import NO_STRIPS, Strips
from layerfield.kernels.systems import (
    Steps,
    System,
    shares_of_rest,
    shares_of_right,
    shares_of_start,
    terms_of,
)
from layerfield.kernels.transforms import Call, ForthAndBack, forth_and_back, transform_one

_SMALL = 1 << 16  # pixels of a plane; from there on more threads are worth more than the cache
_NONE = np.zeros((0, 0, 0), np.float32)
_ONE = np.float32(1)
FIRST: Any = np.int64(0)  # row; a 0 would have loops compiled once more, for it alone


class Coarse(NamedTuple):
    """Steps on larger pixels, which find what takes the place of low frequencies.

    Args:
        system: to be solved.
        constants: of every step.
        pixels: of the picture, that a larger one stands for.
    """

    system: System
    constants: Steps
    pixels: float


class SmallSteps(NamedTuple):
    """The same for compiled loops.

    Args:
        system: to be solved.
        constants: of every step.
        pixels: of the picture, that a larger one stands for.
        strips: there are none.
        forth: the transform of a plane.
        back: the same from frequencies to pixels.
    """

    system: System
    constants: np.ndarray
    pixels: np.float32
    strips: Strips
    forth: Call
    back: Call


def small_transforms(shape: tuple[int, ...], coarse: Coarse) -> ForthAndBack | None:
    """Return the transforms of all steps, or None where making them one by one is no slower.

    Args:
        shape: of low frequencies, `[..., layer, c, fy, fx]`.
        coarse: the steps.

    Raises:
        ValueError: a system of another size.
    """
    pairs, by_row = (*shape[:-1], shape[-1] - 1), coarse.system.by_row
    refuse_other_matrices(coarse.system.symbol.shape, shape[-4], pairs, by_row)
    return None if pairs[-2] * 2 * pairs[-1] >= _SMALL else forth_and_back(pairs, by_row)


def small_steps(coarse: Coarse, transforms: ForthAndBack) -> SmallSteps:
    """Return what compiled loops take, once, as long as the transforms live."""
    rows = np.array(coarse.constants, np.float32)
    rows[0, -1] = 0  # there is no s of one step ago
    calls = transforms.calls(len(rows) + 1)
    return SmallSteps(coarse.system, rows, np.float32(coarse.pixels), NO_STRIPS, *calls)


def steps_at_once(
    seen: Complex[Tensor, "*batch layer c fy fx"], coarse: Coarse
) -> Complex[Tensor, "*batch layer c fy fx"] | None:
    """Return the spectrum of s after steps from b / (W K), or None; see `small_transforms`.

    Colours know nothing of each other: each is the task of one thread, from the first step to the
    last.

    Args:
        seen: the spectrum of b, as `Pairs.low` returns it; on a processor, of single precision.
        coarse: the steps.
    """
    if (transforms := small_transforms((*seen.shape,), coarse)) is None:
        return None
    result, known = seen.clone(), small_steps(coarse, transforms)
    made = numbers_of(result, *seen.shape[-4:-2])
    colours, numbers = len(made) * made.shape[2], len(known.constants) * made.size
    solve_low.in_spans(made, known, _ONE, count=colours, numbers=numbers)
    return result


@compiled
def solve_low(spectrum, steps, factor, begin, end):
    """Put multiples of spectra of s, after all steps, in the place of those of b.

    All layers of one colour after the other, from and to.
    """
    for colour in range(begin, end):
        item, channel = divmod(colour, spectrum.shape[2])
        _solve_colour(spectrum, item, channel, steps, factor)


@compiled
def _solve_colour(spectrum, item, channel, steps, factor):
    _, number, _, height, twice = spectrum.shape
    width, system = twice - 2, steps.system
    by_row, turns = system.by_row, system.turns
    points = np.float32(width // 2 * (1 if by_row else height))
    planes = np.empty((number, height, width), spectrum.dtype)
    for k in range(number):
        low = spectrum[item, k, channel].reshape(1, height, twice)
        plane = planes[k].reshape(1, height, width)
        put_low(plane, low, turns, _ONE / (points * steps.pixels), by_row, FIRST, height)
        transform_one(planes[k], steps.back)
    shadow = _after_steps(planes, steps, points)
    for k in range(number):
        low = spectrum[item, k, channel].reshape(1, height, twice)
        plane = shadow[k].reshape(1, height, width)
        transform_one(shadow[k], steps.forth)
        read_low(low, plane, turns, by_row, FIRST, height)
        for y in range(height):
            _scale(low[0, y], steps.pixels * factor)


@compiled
def _after_steps(data, steps, points):
    """Return s of all layers of one colour."""
    (number, height, width), system, strips = data.shape, steps.system, steps.strips
    by_row, low, high = system.by_row, system.low, system.high
    rows = height if by_row else height // 2 + 1
    window = np.zeros((0, 0), data.dtype)
    other = np.zeros((1, number, 1, 0, 0), data.dtype)
    shadow, before, work = np.empty_like(data), np.empty_like(data), np.empty_like(data)
    start = Sum(data, _NONE, strips, shares_of_start(system.weight, number), low, high)
    for k in range(number):
        for y in range(height):
            blend_row(shadow[k, y], start, k, y, True)
    for n in range(len(steps.constants)):
        constants = steps.constants[n]
        right = Sum(shadow, data, strips, shares_of_right(constants, system.weight), low, high)
        for k in range(number):
            for y in range(height):
                blend_row(work[k, y], right, k, y, True)
            transform_one(work[k], steps.forth)
        spectrum = work.reshape(1, number, 1, height, width)
        terms = terms_of(constants, system, points)
        solve_rows(spectrum, system.symbol, system.turns, terms, other, window, by_row, FIRST, rows)
        ago = _NONE if constants[4] == 0 else before
        rest = Sum(shadow, ago, strips, shares_of_rest(constants), low, high)
        for k in range(number):
            transform_one(work[k], steps.back)
            for y in range(height):
                blend_row(work[k, y], rest, k, y, False)
        shadow, before, work = work, shadow, before
    return shadow


@compiled
def _scale(row, factor):
    for x in range(len(row)):
        row[x] *= factor
