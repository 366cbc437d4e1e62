"""How Fourier transforms are taken apart."""

from functools import lru_cache

import numpy as np

LANES = 8  # transforms that are made side by side
RADICES = (8, 5, 4, 3, 2, 7, 11, 13, 1)  # tried in this order


@lru_cache(maxsize=64)
def radices_of(length: int) -> np.ndarray | None:
    """Return the radices whose product a length is, or None if it has other prime factors.

    >>> radices_of(400).tolist()
    [8, 5, 5, 2]
    """
    found, rest = list[int](), length
    for radix in RADICES[:-1]:
        while rest % radix == 0:
            found.append(radix)
            rest //= radix
    return np.array(found or [1], np.int64) if rest == 1 else None
