"""G(f), the matrix of every frequency, as compiled loops read it.

Where views are all those of a grid, what each direction does to a frequency is multiplied: entry by
entry, G is a number of fy times a number of fx. Two rows of numbers stay in the cache; a plane for
every entry would pass through it in each step.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.compiled import compiled

BESIDE = 32  # numbers of a row that are multiplied side by side; rows are filled up to multiples
_ROUNDING = 1e-6  # share of the largest entry
_ONE = np.float32(1)


class Symbol(NamedTuple):
    """G(f).

    Args:
        whole: `[layer, layer, fy, fx]`, or nothing where it is the product of the others.
        down: `[layer, layer, fy]`.
        across: `[layer, layer, fx]`.
    """

    whole: np.ndarray
    down: np.ndarray
    across: np.ndarray

    @property
    def shape(self) -> tuple[int, ...]:
        """Of G."""
        return (*self.down.shape, self.across.shape[-1])


def symbol_of(symbol: Float[Tensor, "layer layer fy fx"]) -> Symbol:
    """Return G for compiled loops.

    Args:
        symbol: G, of single precision, on a processor.
    """
    across, first = symbol[..., 0, :], symbol[..., :1, 0]
    down = symbol[..., 0] / first
    rest = (symbol - down[..., None] * across[..., None, :]).abs().max()
    whole = symbol[:0] if rest <= _ROUNDING * symbol.abs().max() else symbol
    return Symbol(*(each.contiguous().numpy() for each in (whole, down, across)))


@compiled
def row_of(symbol, k, m, y):
    """Return a row of an entry, and what to multiply it by."""
    if len(symbol.whole) > 0:
        return symbol.whole[k, m, y], _ONE
    return symbol.across[k, m], symbol.down[k, m, y]
