"""Means over the colours of layers in 16-bit words."""

import math

import numpy as np
import torch
from jaxtyping import UInt16
from torch import Tensor

from layerfield.kernels.compiled import compiled

_ONE = 2**16  # what shares are parts of


def gray_words(
    colours: UInt16[Tensor, "*batch layer c y words"],
) -> UInt16[Tensor, "*batch layer 1 y words"]:
    """Return the means over all colours, rounded down.

    Args:
        colours: less than 2^15.
    """
    *batch, channels, height, width = colours.shape
    made = torch.empty((*batch, 1, height, width), dtype=torch.uint16)
    seen = colours.contiguous().view(-1, channels, height, width).numpy()
    to, share = made.view(-1, height, width).numpy(), np.uint32(-(-_ONE // channels))
    _average.in_spans(to, seen, share, count=math.prod(to.shape[:2]), numbers=colours.numel())
    return made


@compiled
def _average(made, colours, share, begin, end):
    """Rows of all planes, one after the other, from and to."""
    height, width = made.shape[1:]
    sums, bits = np.empty(width, np.uint32), np.uint32(16)
    for n in range(begin, end):
        plane, y = divmod(n, height)
        for x in range(width):
            sums[x] = 0
        for c in range(colours.shape[1]):
            for x in range(width):
                sums[x] += np.uint32(colours[plane, c, y, x])
        for x in range(width):
            made[plane, y, x] = np.uint16(np.uint32(sums[x] * share) >> bits)
