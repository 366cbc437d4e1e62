"""The normal equations of a row of pixels, where views stand in a row and light adds up.

Every row of pixels is then a problem of its own, and all have one matrix: A^T M W A of a row, with
the pixels of all layers column by column, i = K x + k. Views have borders, so it differs there from
what it is inside. An entry is no further from the diagonal than light paths through one pixel of
a view are apart, a few pixels: a band matrix, whose systems are solved exactly in one pass there
and one back.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np
from jaxtyping import Float64

from layerfield.projection import Projection, taps_of


def serves_rows(projection: Projection) -> bool:
    """Whether rows of layers are problems of their own: views in a row, layers only shifted."""
    return type(projection) is Projection and projection.is_horizontal


def serves_products(projection: Projection) -> bool:
    """The same where light is multiplied: a path then looks at one pixel of every layer."""
    return serves_rows(projection) and projection.is_whole


def row_reach(projection: Projection) -> int:
    """Return how far entries of the matrix are from its diagonal."""
    return max(max(path)[0] - min(path)[0] for path in _paths(projection))


def row_entries(
    projection: Projection, weights: Sequence[float], width: int
) -> Float64[np.ndarray, "unknown ahead"]:
    """Return H_id, the entry of A^T M W A between unknowns i and i + d of a row, d = 0 .. reach.

    Args:
        projection: A, one that `serves_rows`.
        weights: W, one for every view.
        width: of the views.
    """
    margin, count = projection.margin[1], len(projection.shifts[0])
    paths, reach = _paths(projection), row_reach(projection)
    entries = np.zeros((count * (width + 2 * margin), reach + 1))
    for path, weight in zip(paths, weights, strict=True):
        for (one, share), (other, part) in product(path, path):
            if other >= one:
                seen = slice(one, one + count * width, count)  # by the pixels of a view
                entries[seen, other - one] += weight * share * part
    return entries


def _paths(projection: Projection) -> list[list[tuple[int, float]]]:
    """Return the unknowns that the first pixel of each view looks at, and their weights."""
    margin, count = projection.margin[1], len(projection.shifts[0])
    return [
        [(count * (margin + off) + k, w) for k, (x, _) in enumerate(view) for off, w in taps_of(x)]
        for view in projection.shifts
    ]
