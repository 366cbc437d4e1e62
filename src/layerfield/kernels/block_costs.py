"""How unlike blocks of one picture are to those of another, for every motion that is tried."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from layerfield.kernels.compiled import compiled, native
from layerfield.kernels.radices import LANES

BLOCK, HALF = LANES, 4  # pixels along the sides of half of a block

add_unlike = native("layerfield.kernels.moved_lanes", "add_unlike")


def block_costs(
    new: Float[Tensor, "y x"],
    old: Float[Tensor, "y x"],
    centre: Int[Tensor, "2 by bx"],
    block: int,
    reach: int,
) -> Float[Tensor, "step by bx"]:
    """Return the mean square difference of every block for motions near a first guess.

    Of pixels beyond an edge the nearest one counts.

    Args:
        new: of single precision, on a processor.
        old: the same, and of that size.
        centre: the first guess, x and y, of every block.
        block: pixels along the sides of a block.
        reach: pixels from the first guess, along x and y; motions are in the order of rows.
    """
    rows, columns = centre.shape[-2:]
    result = torch.empty((2 * reach + 1) ** 2, rows, columns, dtype=torch.float32)
    pictures = (each.detach().contiguous().numpy() for each in (new, old))
    given = result.numpy(), *pictures, centre.contiguous().numpy(), block, reach
    _compare.in_spans(*given, count=rows, numbers=len(result) * new.numel())
    return result


def neighbour_costs(
    new: Float[Tensor, "y x"],
    old: Float[Tensor, "y x"],
    motion: Float[Tensor, "2 by bx"],
    steps: Sequence[tuple[int, int]],
) -> Float[Tensor, "step hy bx"]:
    """Return the mean square difference of each half of a block for the motions of those around.

    The upper and the lower half of a block are two rows. Between pixels of the old picture it is
    interpolated linearly.

    Args:
        new: of single precision, on a processor.
        old: the same, and of that size.
        motion: x and y, pixels, of every block of 8x8.
        steps: y and x of those around, in blocks; at an edge the nearest one counts.

    Raises:
        ValueError: pictures or motions that do not fit: loops would go past their ends.
    """
    rows, columns = (-(-n // part) for n, part in zip(new.shape, (HALF, BLOCK), strict=True))
    if old.shape != new.shape or motion.shape != (2, -(-new.shape[0] // BLOCK), columns):
        found = f"an old one of {tuple(old.shape)} and motions {tuple(motion.shape)}"
        raise ValueError(f"found {found}, expected both to fit a picture of {tuple(new.shape)}")
    result = torch.empty(len(steps), rows, columns, dtype=torch.float32)
    pictures = (each.detach().contiguous().numpy() for each in (new, old))
    given = result.numpy(), *pictures, motion.contiguous().numpy(), np.array(steps)
    _compare_around.in_spans(*given, count=rows, numbers=4 * len(steps) * new.numel())
    return result


def cheapest(costs: Float[Tensor, "step by bx"]) -> Int[Tensor, "by bx"]:
    """Return the number of the lowest cost of every block, the first of those that are alike.

    Args:
        costs: of single precision, on a processor.
    """
    result = torch.zeros(costs.shape[1:], dtype=torch.long)
    known = costs.detach().contiguous().numpy()
    _choose.in_spans(result.numpy(), known, count=known.shape[1], numbers=known.size)
    return result


@compiled
def _compare(costs, new, old, centre, block, reach, begin, end):
    """Rows of blocks from and to."""
    height = len(new)
    side, columns = 2 * reach + 1, centre.shape[2]
    across = block + 2 * reach
    # What blocks are compared with, one window beside the other.
    seen = np.empty((across, columns * across), np.float32)
    line = np.empty(columns * block, np.float32)
    sums = np.empty((side * side, columns), np.float32)
    share = np.float32(1.0 / (block * block))
    for row in range(begin, end):
        sums[:] = 0
        for y in range(across):
            _gather(seen[y], old, centre[:, row], row * block + y - reach, block, reach)
        for y in range(block):
            _continue(line, new[min(row * block + y, height - 1)])
            for i in range(side):
                for j in range(side):
                    _add(sums[i * side + j], seen[y + i], line, j, block, across)
        for step in range(side * side):
            for column in range(columns):
                costs[step, row, column] = share * sums[step, column]


@compiled
def _continue(line, pixels):
    """Put pixels on a line that may be longer."""
    width = len(pixels)
    line[:width] = pixels
    line[width:] = pixels[width - 1]


@compiled
def _gather(seen, old, centre, y, block, reach):
    """Put a row of the window of every block beside that of the one before."""
    height, width = old.shape
    across = block + 2 * reach
    for column in range(centre.shape[1]):
        pixels = old[min(max(y + centre[1, column], 0), height - 1)]
        left, to = column * block + centre[0, column] - reach, column * across
        if left >= 0 and left + across <= width:
            for x in range(across):
                seen[to + x] = pixels[left + x]
        else:
            for x in range(across):
                seen[to + x] = pixels[min(max(left + x, 0), width - 1)]


@compiled
def _add(sums, seen, line, step, block, across):
    """Add the square differences of a row of pixels to those of their blocks."""
    for column in range(len(sums)):
        known, new = seen[column * across + step :], line[column * block :]
        total = np.float32(0)
        for x in range(block):
            difference = known[x] - new[x]
            total += difference * difference
        sums[column] += total


@compiled
def _compare_around(costs, new, old, motion, steps, begin, end):
    """Rows of halves of blocks from and to."""
    height, width = new.shape
    rows, columns = motion.shape[1:]
    factors, sums = np.empty(4, np.float32), np.empty(BLOCK, np.float32)
    for half in range(begin, end):
        top, bottom = half * HALF, min(half * HALF + HALF, height)
        for column in range(columns):
            left, right = column * BLOCK, min(column * BLOCK + BLOCK, width)
            pixels = np.float32((bottom - top) * (right - left))
            for step in range(len(steps)):
                row = min(max(half // 2 + steps[step, 0], 0), rows - 1)
                beside = min(max(column + steps[step, 1], 0), columns - 1)
                x, y = motion[0, row, beside], motion[1, row, beside]
                away, down = left + int(np.floor(x)), top + int(np.floor(y))
                inside = 0 <= away < width - BLOCK and 0 <= down < height - (bottom - top)
                if inside and right - left == BLOCK:
                    _weigh(factors, x - np.floor(x), y - np.floor(y))
                    sums[:] = 0
                    for line in range(bottom - top):
                        there, here = (down + line) * width + away, (top + line) * width + left
                        add_unlike(factors, old, there, width, new, here, sums)
                    total = sums.sum()
                else:
                    total = _unlike_at_edges(factors, new, old, top, bottom, left, right, x, y)
                costs[step, half, column] = total / pixels


@compiled
def _weigh(factors, across, below):
    """Find the shares of the four pixels that something between them has."""
    one = np.float32(1)
    factors[0], factors[1] = (one - below) * (one - across), (one - below) * across
    factors[2], factors[3] = below * (one - across), below * across


@compiled
def _unlike_at_edges(factors, new, old, top, bottom, left, right, x, y):
    """Return the square difference of what may come from beyond edges, or of a part of a half."""
    height, width = old.shape
    last, lowest = np.float32(width - 1), np.float32(height - 1)
    total = np.float32(0)
    for row in range(top, bottom):
        down = min(max(np.float32(row) + y, np.float32(0)), lowest)
        upper, lower = old[int(down)], old[min(int(down) + 1, height - 1)]
        for column in range(left, right):
            there = min(max(np.float32(column) + x, np.float32(0)), last)
            i, j = int(there), min(int(there) + 1, width - 1)
            _weigh(factors, there - np.float32(i), down - np.floor(down))
            seen = factors[0] * upper[i] + factors[1] * upper[j]
            seen += factors[2] * lower[i] + factors[3] * lower[j]
            total += (seen - new[row, column]) ** 2
    return total


@compiled
def _choose(chosen, costs, begin, end):
    """Rows of blocks from and to."""
    columns = costs.shape[2]
    least = np.empty(columns, np.float32)
    for row in range(begin, end):
        least[:] = costs[0, row]
        for step in range(1, len(costs)):
            for column in range(columns):
                if costs[step, row, column] < least[column]:
                    least[column] = costs[step, row, column]
                    chosen[row, column] = step
