"""Pictures of half the size, and what was found there brought back to the whole size."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Num, UInt8, UInt16
from torch import Tensor

from layerfield.kernels.blends import planes_of
from layerfield.kernels.codes import look_up
from layerfield.kernels.compiled import compiled
from layerfield.kernels.starts import Even, even_of


def halved_views(
    stored: Num[Tensor, "*batch view c y x"],
    chosen: Sequence[int],
    table: Float[Tensor, " code"] | None,
    share: float,
) -> Float[Tensor, "*batch some c hy hx"]:
    """Return the means of 4x4 pixels, of shares 1, 3, 3, 1; beyond its edges a picture goes on.

    Args:
        stored: codes, or values of single precision, on a processor.
        chosen: of which views.
        table: what every code stands for.
        share: what it is multiplied by, where there is no table.
    """
    *batch, number, channels, height, width = stored.shape
    size = len(chosen), channels, -(-height // 2), -(-width // 2)
    made = torch.empty((*batch, *size), dtype=torch.float32)
    planes = made.view(-1, *size).numpy()
    known = stored.detach().contiguous().view(-1, number, channels, height, width).numpy()
    which, count, numbers = np.array(chosen), made[..., 0, 0].numel(), made.numel()
    if table is None:
        given = planes, known, which, np.float32(share / 64)
        _average.in_spans(*given, count=count, numbers=numbers)
    else:
        given = planes, known, which, np.float32(1 / 64), table.detach().numpy()
        _average_known.in_spans(*given, count=count, numbers=numbers)
    return made


def halved_codes(
    stored: UInt8[Tensor, "*batch view c y x"], chosen: Sequence[int]
) -> UInt16[Tensor, "*batch some c hy hx"]:
    """Return the same of 8-bit codes as codes of 16 bits, rounded.

    White comes to 255 64, and 2^16 - 1 is that, four times and a 64th.
    """
    *batch, number, channels, height, width = stored.shape
    size = len(chosen), channels, -(-height // 2), -(-width // 2)
    made = torch.empty((*batch, *size), dtype=torch.uint16)
    planes = made.view(-1, *size).numpy()
    known = stored.contiguous().view(-1, number, channels, height, width).numpy()
    given, count = (planes, known, np.array(chosen)), made[..., 0, 0].numel()
    _average_codes.in_spans(*given, count=count, numbers=made.numel())
    return made


@compiled
def _average_codes(made, stored, chosen, begin, end):
    width = stored.shape[4]
    sums = np.empty(width + 4 - width % 2, np.uint16)
    pairs = sums.view(np.uint32)
    for n in range(begin, end):
        item, view, c = _plane_of(n, made)
        plane, to = stored[item, chosen[view], c], made[item, view, c]
        for y in range(len(to)):
            first, second, third, last = _four_rows(plane, y)
            for x in range(width):
                outer, inner = first[x] + last[x], second[x] + third[x]
                sums[x + 1] = outer + 3 * inner
            sums[0], sums[width + 1], sums[width + 2] = sums[1], sums[width], sums[width]
            _add_pairs(to[y], pairs)


@compiled
def _plane_of(n, made):
    """Return which light field, view and channel the plane of this number is."""
    some, channels = made.shape[1:3]
    item, rest = divmod(n, some * channels)
    view, c = divmod(rest, channels)
    return item, view, c


@compiled
def _four_rows(plane, y):
    """Return the rows that one of half size is the mean of; beyond edges a picture goes on."""
    last = len(plane) - 1
    first, second = plane[max(2 * y - 1, 0)], plane[2 * y]
    return first, second, plane[min(2 * y + 1, last)], plane[min(2 * y + 2, last)]


@compiled
def _add_pairs(to, pairs):
    """Write codes of the sums of four numbers, of shares 1, 3, 3, 1; two go in a pair."""
    low, two, half, bits = np.uint32(2**16 - 1), np.uint32(2), np.uint32(32), np.uint32(6)
    high, three = np.uint32(16), np.uint32(3)
    for x in range(len(to)):
        left, right = pairs[x], pairs[x + 1]
        outer = np.uint32((left & low) + (right >> high))
        total = np.uint32(outer + three * ((left >> high) + (right & low)))
        to[x] = (total << two) + ((total + half) >> bits)


@compiled
def _average(made, stored, chosen, share, begin, end):
    sums = np.empty(stored.shape[4] + 3, np.float32)
    for n in range(begin, end):
        item, view, c = _plane_of(n, made)
        _halve(made[item, view, c], stored[item, chosen[view], c], sums, share)


@compiled
def _average_known(made, stored, chosen, share, table, begin, end):
    height, width = stored.shape[3:]
    sums, plane = np.empty(width + 3, np.float32), np.empty((height, width), np.float32)
    for n in range(begin, end):
        item, view, c = _plane_of(n, made)
        codes = stored[item, chosen[view], c]
        for y in range(height):
            look_up(plane[y], codes[y], table)
        _halve(made[item, view, c], plane, sums, share)


@compiled
def _halve(made, plane, sums, share):
    """Write the sums of four rows, of shares 1, 3, 3, 1, then of four columns."""
    width, three = plane.shape[1], np.float32(3)
    for y in range(len(made)):
        first, second, third, last = _four_rows(plane, y)
        for x in range(width):
            outer = np.float32(first[x]) + np.float32(last[x])
            sums[x + 1] = outer + three * (np.float32(second[x]) + np.float32(third[x]))
        sums[0], sums[width + 1], sums[width + 2] = sums[1], sums[width], sums[width]
        to = made[y]
        for x in range(len(to)):
            outer = sums[2 * x] + sums[2 * x + 3]
            to[x] = share * (outer + three * (sums[2 * x + 1] + sums[2 * x + 2]))


class Balanced(NamedTuple):
    """A balanced start, for compiled loops.

    Args:
        seen: `[plane, y, x]`.
        unit: what 1 of it stands for.
        even: what makes the start of it.
    """

    seen: np.ndarray
    unit: np.float32
    even: Even


class Refinement(NamedTuple):
    """A balanced start and a change at half size, for compiled loops; see `refinement_of`.

    Args:
        start: that start.
        layers: `[plane, hy, hx]`.
        less: the balanced start of those, taken away from them; or of no rows.
        before: pixels of whole size by which they begin before the others.
        law: of starts, or none.
    """

    start: Balanced
    layers: np.ndarray
    less: Balanced
    before: tuple[int, int]
    law: np.ndarray


_NO_PLANES, _NO_WORDS = np.zeros((0, 0, 0), np.float32), np.zeros((0, 0, 0), np.uint16)
_NO_EVEN, _NO_LAW = Even(_NO_PLANES, np.zeros((0, 0), np.float32)), np.zeros(0, np.float32)
NOTHING = Balanced(_NO_PLANES, np.float32(1), _NO_EVEN)
NOT_REFINED = Refinement(NOTHING._replace(seen=_NO_WORDS), _NO_PLANES, NOTHING, (0, 0), _NO_LAW)


def balanced(
    seen: Num[Tensor, "*batch layer c ly more"],
    shares: Float[Tensor, "layer 1 ly lx"],
    rest: Float[Tensor, "*batch 1 c 1 1"],
    unit: float = 1.0,
) -> Balanced:
    """Return a balanced start for compiled loops.

    Args:
        seen: of single precision, on a processor, as all others; or words, see `seen_words`.
        shares: what to multiply it by; where that is 0
        rest: is taken.
        unit: what 1 of `seen` stands for.
    """
    even = even_of(seen[..., : shares.shape[-1]], shares, rest)
    return Balanced(planes_of(seen.contiguous()), np.float32(unit), even)


def refinement_of(
    start: Balanced,
    layers: Float[Tensor, "*batch layer c hy hx"],
    before: tuple[int, int],
    *,
    less: Balanced = NOTHING,
    law: Float[Tensor, " level"] | None = None,
) -> Refinement:
    """Return a start and, added to it, layers of half size, interpolated linearly.

    With a law, what it makes of the start, multiplied by them.

    Args:
        start: of whole size.
        layers: as far as those of whole size and no less; they go on at their edges.
        before: pixels (y, x) of whole size by which they begin before those, 0 or 1.
        less: what is taken away from them first.
        law: of starts from 0 to 1, at even steps.
    """
    levels = _NO_LAW if law is None else law.numpy()
    return Refinement(start, planes_of(layers.contiguous()), less, before, levels)


def refined(refinement: Refinement, shape: Sequence[int]) -> Float[Tensor, "*batch layer c ly lx"]:
    """Return what a refinement comes to."""
    made = torch.empty(shape, dtype=torch.float32)
    planes = planes_of(made)
    count = len(planes) * shape[-2]
    _refine.in_spans(planes, refinement, count=count, numbers=made.numel())
    return made


_NEAR, _FAR, _HALF = np.float32(0.75), np.float32(0.25), np.float32(0.5)


@compiled
def _refine(made, given, begin, end):
    """Rows of all planes, one after the other, from and to."""
    height = made.shape[1]
    beside, wide = room_to_refine(given)
    for n in range(begin, end):
        plane, y = divmod(n, height)
        refine_row(made[plane, y], given, plane, y, beside, wide)


@compiled
def room_to_refine(given):
    """Return what `refine_row` writes on."""
    columns = given.layers.shape[2]
    return np.empty(columns + 2, np.float32), np.empty(2 * columns, np.float32)


@compiled
def refine_row(to, given, plane, y, beside, wide):
    """Write a row; with a law start and layers are multiplied, and added up without."""
    rows, columns = given.layers.shape[1:]
    here, below = divmod(y + given.before[0], 2)
    other = min(max(here + 2 * below - 1, 0), rows - 1)
    near, far = given.layers[plane, here], given.layers[plane, other]
    for x in range(columns):
        beside[x + 1] = _NEAR * near[x] + _FAR * far[x]
    if len(given.less.seen) > 0:
        _take_away(beside, given.less, plane, here, _NEAR)
        _take_away(beside, given.less, plane, other, _FAR)
    beside[0], beside[columns + 1] = beside[1], beside[columns]
    for x in range(columns):
        wide[2 * x] = _NEAR * beside[x + 1] + _FAR * beside[x]
        wide[2 * x + 1] = _NEAR * beside[x + 1] + _FAR * beside[x + 2]
    layer, rest = _of_plane(given.start.even, plane)
    shares, light = given.start.even.shares[layer, y], given.start.seen[plane, y]
    own, unit = wide[given.before[1] :], given.start.unit
    if len(given.law) == 0:
        for x in range(len(to)):
            start = shares[x] * (unit * np.float32(light[x])) if shares[x] > 0 else rest
            to[x] = start + own[x]
    else:
        most = np.float32(len(given.law) - 1)
        for x in range(len(to)):
            start = shares[x] * (unit * np.float32(light[x])) if shares[x] > 0 else rest
            level = min(max(start * most + _HALF, _HALF), most)
            to[x] = given.law[np.int64(level)] * own[x]


@compiled
def _take_away(beside, less, plane, y, factor):
    """Subtract a row of a balanced start, times a factor."""
    layer, rest = _of_plane(less.even, plane)
    shares, light = less.even.shares[layer, y], less.seen[plane, y]
    for x in range(len(light)):
        start = shares[x] * light[x] if shares[x] > 0 else rest
        beside[x + 1] -= factor * start


@compiled
def _of_plane(even, plane):
    """Return the layer of a plane, and what its pixels take that nobody sees."""
    both, channel = divmod(plane, even.rest.shape[1])
    item, layer = divmod(both, len(even.shares))
    return layer, even.rest[item, channel]
