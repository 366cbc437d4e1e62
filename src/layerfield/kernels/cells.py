"""Cells of 8x8 pixels: what is known of them, a small network on that, and what is added."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.blends import planes_of
from layerfield.kernels.compiled import compiled

CELL = 8  # pixels along the sides
LEAK = 0.1  # what is left of negative values between convolutions


def signs_of_cells(
    shadow: Float[Tensor, "*batch ty tx"], size: tuple[int, int], bounds: tuple[float, float]
) -> Float[Tensor, "*batch 4 cy cx"]:
    """Return the least and the highest s of every cell, and its means above and below the bounds.

    Args:
        shadow: s, of single precision, on a processor.
        size: height and width of what has cells, in the top left corner.
        bounds: where what is above and below begins.
    """
    cells = (-(-size[0] // CELL), -(-size[1] // CELL))
    result = torch.empty(*shadow.shape[:-2], 4, *cells)
    planes = planes_of(shadow.detach().contiguous())
    low, high = (np.float32(each) for each in bounds)
    given = result.view(-1, 4, *cells).numpy(), planes, *size, low, high
    _look.in_spans(*given, count=len(planes) * cells[0], numbers=planes.size)
    return result


def answers_of_cells(
    known: Float[Tensor, "picture layer sign cy cx"],
    hidden: Sequence[tuple[Tensor, Tensor, Tensor]],
    last: Float[Tensor, "1 channel 3 3"],
) -> Float[Tensor, "picture layer cy cx"]:
    """Return what a network says to all cells, before its mean over layers is taken off.

    Args:
        known: of single precision, on a processor.
        hidden: taps for every layer, taps for the mean of all, and what is added; see `Relief`.
        last: taps for every layer.
    """
    result = torch.empty(*known.shape[:2], *known.shape[3:])
    own, common, bias = (
        tuple(each.detach().contiguous().numpy() for each in part)
        for part in zip(*hidden, strict=True)
    )
    given = result.numpy(), known.contiguous().numpy(), own, common, bias
    taps = last.detach().contiguous().numpy()
    numbers = known.numel() * (1 + sum(len(each) for each in bias))
    _answer.in_spans(*given, taps, count=len(known), numbers=numbers)
    return result


def with_cells(
    shadow: Float[Tensor, "*batch ty tx"],
    change: Float[Tensor, "*batch cy cx"],
    size: tuple[int, int],
) -> Float[Tensor, "*batch ty tx"]:
    """Return pixels and what cells add to them, linear between the middles of cells.

    Args:
        shadow: of single precision, on a processor.
        change: of every cell.
        size: height and width of what has cells, in the top left corner.
    """
    made = torch.empty(shadow.shape)
    given = (planes_of(each.detach().contiguous()) for each in (made, shadow, change))
    _add.in_spans(*given, *size, count=made[..., 0].numel(), numbers=made.numel())
    return made


@compiled
def _look(made, planes, height, width, low, high, begin, end):
    """Rows of cells of all planes, one after the other, from and to."""
    rows, columns = made.shape[2:]
    wide, zero = columns * CELL, np.float32(0)
    least, most = np.empty(wide, np.float32), np.empty(wide, np.float32)
    over, under = np.empty(wide, np.float32), np.empty(wide, np.float32)
    for place in range(begin, end):
        plane, row = divmod(place, rows)
        first, last = row * CELL, min(row * CELL + CELL, height)
        for y in range(first, last):
            line = planes[plane, y]
            if y == first:
                for x in range(width):
                    least[x] = most[x] = line[x]
                over[:] = 0
                under[:] = 0
            for x in range(width):
                value = line[x]
                least[x] = min(least[x], value)
                most[x] = max(most[x], value)
                over[x] += max(value - high, zero)
                under[x] += max(low - value, zero)
        for column in range(columns):
            left, right = column * CELL, min(column * CELL + CELL, width)
            pixels = np.float32((last - first) * (right - left))
            made[plane, 0, row, column] = least[left:right].min()
            made[plane, 1, row, column] = most[left:right].max()
            made[plane, 2, row, column] = over[left:right].sum() / pixels
            made[plane, 3, row, column] = under[left:right].sum() / pixels


@compiled
def _answer(made, known, own, common, bias, last, begin, end):
    """All layers of pictures, from and to."""
    number, signs, height, width = known.shape[1:]
    for picture in range(begin, end):
        seen = np.empty((number, signs, height + 2, width + 2), np.float32)
        seen[:, :, 1:-1, 1:-1] = known[picture]
        for n in range(len(own)):
            for k in range(number):
                _frame(seen[k])
            shared = _of_all(seen, common[n], bias[n])
            after = np.empty((number, len(shared), height + 2, width + 2), np.float32)
            for k in range(number):
                found = shared.copy()
                _convolve(found, seen[k], own[n])
                _go_on(after[k], found, seen[k], n > 0)
            seen = after
        for k in range(number):
            _frame(seen[k])
            made[picture, k] = 0
            _convolve(made[picture, k : k + 1], seen[k], last)


@compiled
def _of_all(seen, taps, bias):
    """Return what is said to all layers of the display alike: by their mean."""
    number, signs, height, width = seen.shape
    mean = np.zeros((signs, height, width), np.float32)
    for k in range(number):
        for sign in range(signs):
            for y in range(height):
                mean[sign, y] += seen[k, sign, y] / np.float32(number)
    found = np.empty((len(bias), height - 2, width - 2), np.float32)
    for channel in range(len(bias)):
        found[channel] = bias[channel]
    _convolve(found, mean, taps)
    return found


@compiled
def _go_on(after, found, seen, adds):
    """Put what was found, and what was seen before if that is asked for, inside of a frame."""
    channels, height, width = found.shape
    for channel in range(channels):
        for y in range(height):
            line, old = found[channel, y], seen[channel if adds else 0, y + 1]
            for x in range(width):
                value = max(line[x], np.float32(LEAK) * line[x])
                after[channel, y + 1, x + 1] = value + old[x + 1] if adds else value


@compiled
def _frame(planes):
    """Put what is nearest around planes."""
    for plane in planes:
        plane[1:-1, 0] = plane[1:-1, 1]
        plane[1:-1, -1] = plane[1:-1, -2]
        plane[0] = plane[1]
        plane[-1] = plane[-2]


@compiled
def _convolve(made, seen, taps):
    """Add what 3x3 taps find in planes that have a frame."""
    height, width = made.shape[1:]
    for y in range(height):
        for channel in range(len(made)):
            line = made[channel, y]
            for sign in range(len(seen)):
                for j in range(3):
                    row, three = seen[sign, y + j], taps[channel, sign, j]
                    left, middle, right = three[0], three[1], three[2]
                    for x in range(width):
                        line[x] += left * row[x] + middle * row[x + 1] + right * row[x + 2]


@compiled
def _add(made, planes, cells, height, width, begin, end):
    """Rows of pixels of all planes, one after the other, from and to."""
    rows, columns = cells.shape[1:]
    high = planes.shape[1]
    half, one = np.float32(0.5), np.float32(1) / np.float32(CELL)
    # Half a cell more at each side: what lies beyond the last middles is as it is there.
    between = np.empty(columns + 2, np.float32)
    line = np.empty((columns + 1) * CELL, np.float32)
    for place in range(begin, end):
        plane, y = divmod(place, high)
        made[plane, y] = planes[plane, y]
        if y >= height:
            continue
        at = max((np.float32(y) + half) * one - half, np.float32(0))
        upper = int(at)
        lower, below = min(upper + 1, rows - 1), at - np.float32(upper)
        for x in range(columns):
            first, second = cells[plane, upper, x], cells[plane, lower, x]
            between[x + 1] = first + below * (second - first)
        between[0], between[columns + 1] = between[1], between[columns]
        for column in range(columns + 1):
            first, step = between[column], between[column + 1] - between[column]
            for x in range(CELL):
                line[column * CELL + x] = first + (np.float32(x) + half) * one * step
        for x in range(width):
            made[plane, y, x] += line[x + CELL // 2]
