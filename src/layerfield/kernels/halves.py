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


class Refinement(NamedTuple):
    """A balanced start and a ratio at half size, for compiled loops; see `refined`.

    Args:
        seen: `[plane, y, x]`.
        even: what makes the start of it.
        layers: `[plane, hy, hx]`.
        before: pixels of whole size by which they begin before the others.
        law: of starts.
    """

    seen: np.ndarray
    even: Even
    layers: np.ndarray
    before: tuple[int, int]
    law: np.ndarray


def refined(
    seen: Float[Tensor, "*batch layer c ly lx"],
    even: tuple[Float[Tensor, "layer 1 ly lx"], Float[Tensor, "*batch 1 c 1 1"]],
    ratio: Float[Tensor, "*batch layer c hy hx"],
    before: tuple[int, int],
    law: Float[Tensor, " level"],
) -> Float[Tensor, "*batch layer c ly lx"]:
    """Return what a law makes of the balanced start, times a ratio of half size.

    Args:
        seen: of single precision, on a processor, as all others.
        even: what to multiply it by for the start, and what is taken where that is 0.
        ratio: as far as layers of whole size and no less; it goes on at its edges, and between its
            pixels linearly.
        before: pixels (y, x) of whole size by which it begins before those, 0 or 1.
        law: of starts from 0 to 1, at even steps.
    """
    made = torch.empty(seen.shape, dtype=torch.float32)
    planes, known = planes_of(made), planes_of(seen.contiguous())
    layers = planes_of(ratio.contiguous())
    given = Refinement(known, even_of(seen, *even), layers, before, law.numpy())
    count = len(planes) * seen.shape[-2]
    _refine.in_spans(planes, given, count=count, numbers=made.numel())
    return made


_NEAR, _FAR, _HALF = np.float32(0.75), np.float32(0.25), np.float32(0.5)


@compiled
def _refine(made, given, begin, end):
    """Rows of all planes, one after the other, from and to."""
    height, columns = made.shape[1], given.layers.shape[2]
    beside, wide = np.empty(columns + 2, np.float32), np.empty(2 * columns, np.float32)
    for n in range(begin, end):
        plane, y = divmod(n, height)
        _refine_row(made[plane, y], given, plane, y, beside, wide)


@compiled
def _refine_row(to, given, plane, y, beside, wide):
    rows, columns = given.layers.shape[1:]
    here, below = divmod(y + given.before[0], 2)
    other = min(max(here + 2 * below - 1, 0), rows - 1)
    near, far = given.layers[plane, here], given.layers[plane, other]
    for x in range(columns):
        beside[x + 1] = _NEAR * near[x] + _FAR * far[x]
    beside[0], beside[columns + 1] = beside[1], beside[columns]
    for x in range(columns):
        wide[2 * x] = _NEAR * beside[x + 1] + _FAR * beside[x]
        wide[2 * x + 1] = _NEAR * beside[x + 1] + _FAR * beside[x + 2]
    both, channel = divmod(plane, given.even.rest.shape[1])
    item, layer = divmod(both, len(given.even.shares))
    rest, shares = given.even.rest[item, channel], given.even.shares[layer, y]
    light, own, most = given.seen[plane, y], wide[given.before[1] :], np.float32(len(given.law) - 1)
    for x in range(len(to)):
        start = shares[x] * light[x] if shares[x] > 0 else rest
        level = min(max(start * most + _HALF, _HALF), most)
        to[x] = given.law[np.int64(level)] * own[x]
