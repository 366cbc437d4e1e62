"""How unlike blocks of one picture are to those of another, for every motion that is tried."""

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from layerfield.kernels.compiled import compiled


def block_costs(
    new: Float[Tensor, "y x"],
    old: Float[Tensor, "y x"],
    centre: Int[Tensor, "2 by bx"],
    block: int,
    reach: int,
) -> Float[Tensor, "step by bx"]:
    """Return the mean square difference of every block and its neighbours near a first guess.

    Neighbours are those of 3x3 blocks that there are. Of pixels beyond an edge the nearest one
    counts.

    Args:
        new: of single precision, on a processor.
        old: the same, and of that size.
        centre: the first guess, x and y, of every block.
        block: pixels along the sides of a block.
        reach: pixels from the first guess, along x and y; motions are in the order of rows.
    """
    rows, columns = centre.shape[-2:]
    alone = torch.empty((2 * reach + 1) ** 2, rows, columns)
    result = torch.empty_like(alone)
    pictures = (each.detach().contiguous().numpy() for each in (new, old))
    given = alone.numpy(), *pictures, centre.contiguous().numpy(), block, reach
    _compare.in_spans(*given, count=rows, numbers=len(alone) * new.numel())
    _mean.in_spans(result.numpy(), alone.numpy(), count=len(alone), numbers=alone.numel())
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
def _mean(result, costs, begin, end):
    """Of all neighbours, for motions from and to."""
    rows, columns = costs.shape[1:]
    line = np.empty(columns, np.float32)
    for step in range(begin, end):
        for row in range(rows):
            first, last = max(row - 1, 0), min(row + 2, rows)
            line[:] = 0
            for each in range(first, last):
                line += costs[step, each]
            for column in range(columns):
                left, right = max(column - 1, 0), min(column + 2, columns)
                total = np.float32(0)
                for each in range(left, right):
                    total += line[each]
                count = np.float32((last - first) * (right - left))
                result[step, row, column] = total / count


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
