"""Pictures of half the size, and what was found there brought back to the whole size."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Num
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
    which, count, numbers = np.array(chosen), len(planes) * size[0], made.numel()
    if table is None:
        given = planes, known, which, np.float32(share / 64)
        _average.in_spans(*given, count=count, numbers=numbers)
    else:
        given = planes, known, which, np.float32(1 / 64), table.detach().numpy()
        _average_known.in_spans(*given, count=count, numbers=numbers)
    return made


@compiled
def _average(made, stored, chosen, share, begin, end):
    sums = np.empty(stored.shape[4] + 3, np.float32)
    for n in range(begin, end):
        item, view = divmod(n, len(chosen))
        for c in range(stored.shape[2]):
            _halve(made[item, view, c], stored[item, chosen[view], c], sums, share)


@compiled
def _average_known(made, stored, chosen, share, table, begin, end):
    channels, height, width = stored.shape[2:]
    sums, plane = np.empty(width + 3, np.float32), np.empty((height, width), np.float32)
    for n in range(begin, end):
        item, view = divmod(n, len(chosen))
        for c in range(channels):
            codes = stored[item, chosen[view], c]
            for y in range(height):
                look_up(plane[y], codes[y], table)
            _halve(made[item, view, c], plane, sums, share)


@compiled
def _halve(made, plane, sums, share):
    """Write the sums of four rows, of shares 1, 3, 3, 1, then of four columns."""
    (height, width), three = plane.shape, np.float32(3)
    for y in range(len(made)):
        first, second = plane[max(2 * y - 1, 0)], plane[2 * y]
        third, last = plane[min(2 * y + 1, height - 1)], plane[min(2 * y + 2, height - 1)]
        for x in range(width):
            outer = np.float32(first[x]) + np.float32(last[x])
            sums[x + 1] = outer + three * (np.float32(second[x]) + np.float32(third[x]))
        sums[0], sums[width + 1], sums[width + 2] = sums[1], sums[width], sums[width]
        to = made[y]
        for x in range(len(to)):
            outer = sums[2 * x] + sums[2 * x + 3]
            to[x] = share * (outer + three * (sums[2 * x + 1] + sums[2 * x + 2]))


class Refinement(NamedTuple):
    """A balanced start and a change at half size, for compiled loops; see `refinement_of`.

    Args:
        seen: `[plane, ly, lx]`.
        even: what makes the start of it.
        change: `[plane, hy, hx]`.
        before: pixels of whole size by which that begins before the layers.
        law: of starts, or none.
    """

    seen: np.ndarray
    even: Even
    change: np.ndarray
    before: tuple[int, int]
    law: np.ndarray


def refinement_of(
    seen: Float[Tensor, "*batch layer c ly lx"],
    shares: Float[Tensor, "layer 1 ly lx"],
    rest: Float[Tensor, "*batch 1 c 1 1"],
    change: Float[Tensor, "*batch layer c hy hx"],
    before: tuple[int, int],
    law: Float[Tensor, " level"] | None = None,
) -> Refinement:
    """Return a balanced start and, added to it, a change at half size, interpolated linearly.

    With a law, what it makes of the start, multiplied by the change.

    Args:
        seen: of single precision, on a processor, as all others.
        shares: what to multiply it by; where that is 0
        rest: is taken.
        change: as far as the layers and no less; goes on at its edges.
        before: pixels (y, x) of whole size by which it begins before the layers, 0 or 1.
        law: of starts from 0 to 1, at even steps.
    """
    planes = (planes_of(each.contiguous()) for each in (seen, change))
    levels = np.zeros(0, np.float32) if law is None else law.numpy()
    known, changes = planes
    return Refinement(known, even_of(seen, shares, rest), changes, before, levels)


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
    columns = given.change.shape[2]
    return np.empty(columns + 2, np.float32), np.empty(2 * columns, np.float32)


@compiled
def refine_row(to, given, plane, y, beside, wide):
    """Write a row; with a law start and change are multiplied, and added up without."""
    rows, columns = given.change.shape[1:]
    both, channel = divmod(plane, given.even.rest.shape[1])
    item, layer = divmod(both, len(given.even.shares))
    here, below = divmod(y + given.before[0], 2)
    other = min(max(here + 2 * below - 1, 0), rows - 1)
    near, far = given.change[plane, here], given.change[plane, other]
    for x in range(columns):
        beside[x + 1] = _NEAR * near[x] + _FAR * far[x]
    beside[0], beside[columns + 1] = beside[1], beside[columns]
    for x in range(columns):
        wide[2 * x] = _NEAR * beside[x + 1] + _FAR * beside[x]
        wide[2 * x + 1] = _NEAR * beside[x + 1] + _FAR * beside[x + 2]
    shares, light = given.even.shares[layer, y], given.seen[plane, y]
    rest, own = given.even.rest[item, channel], wide[given.before[1] :]
    if len(given.law) == 0:
        for x in range(len(to)):
            start = shares[x] * light[x] if shares[x] > 0 else rest
            to[x] = start + own[x]
    else:
        most = np.float32(len(given.law) - 1)
        for x in range(len(to)):
            start = shares[x] * light[x] if shares[x] > 0 else rest
            level = min(max(start * most + _HALF, _HALF), most)
            to[x] = given.law[np.int64(level)] * own[x]
