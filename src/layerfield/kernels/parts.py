"""Several passes over pictures at once: each some rows behind the one before, part by part.

What one pass has made is then still at hand for the next. A pass looks as far as it reaches, at
what those before have made and at what later ones have not. So parts shrink from pass to pass where
others are beside them, and what that leaves between two is a part that grows. Threads make parts in
any order: what comes out is the same.
"""

from functools import lru_cache
from itertools import pairwise

import numpy as np

from layerfield.kernels.compiled import compiled

_ROWS, _OF_ONE = 64, 40  # of a part, at the least, and where there is a single plane
TOGETHER = 4  # rows of a turn: they look at the same rows of other layers, which are at hand then


@lru_cache(maxsize=16)
def parts_of(planes: int, height: int, reach: int, passes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return parts of planes, and how many have to be done before each.

    Args:
        planes: that know nothing of each other.
        height: of each.
        reach: rows that a pass looks up and down.
        passes: how many.

    Returns:
        `[part, 5]`: which plane, from which row and to which, and by how many rows both move with
        every pass; and `[part]`.
    """
    least = _ROWS if planes > 1 else _OF_ONE
    count = max(1, height // max(least, 2 * reach * passes))
    ends = [height * n // count for n in range(count + 1)]
    shrinking = [
        (plane, top, bottom, reach * (top > 0), -reach * (bottom < height))
        for plane in range(planes)
        for top, bottom in pairwise(ends)
    ]
    growing = [(plane, row, row, -reach, reach) for plane in range(planes) for row in ends[1:-1]]
    needs = [plane * count + n + 2 for plane in range(planes) for n in range(count - 1)]
    return np.array(shrinking + growing), np.array([0] * len(shrinking) + needs)


@compiled
def steps_of(parts, part, passes, reach):
    """Return from which step to which there are rows of a part for one of its passes."""
    _, top, bottom, down, up = parts[part]
    last = passes - 1
    first, end = min(top, top + last * down), max(bottom, bottom + last * up) + last * (reach + 1)
    return first // TOGETHER, -(-end // TOGETHER)


@compiled
def rows_at(parts, part, which, step, reach):
    """Return from which row to which a pass has its turn."""
    _, top, bottom, down, up = parts[part]
    row = step * TOGETHER - (reach + 1) * which
    return max(row, top + which * down), min(row + TOGETHER, bottom + which * up)
