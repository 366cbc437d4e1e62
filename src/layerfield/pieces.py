"""Pieces of views and layers that fit into a processor's cache.

What looks at one view after the other, and adds to layers what it finds there, goes over the layers
as often as there are views. Piece by piece it takes half the time for large pictures, and time
grows in proportion to their pixels.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from layerfield.kept_views import KeptViews
from layerfield.projection import Projection

_PIXELS = 1 << 16  # of a piece, for every thread: some such arrays in the cache of a core


@dataclass(frozen=True)
class Piece:
    """Channels and rows of views, and the rows of layers that they look at.

    Args:
        channels: of views and layers.
        rows: of the views; every row is of one piece.
        beneath: rows of the layers; pieces share the margin.
    """

    channels: slice
    rows: slice
    beneath: slice

    def of_views(self, views: KeptViews) -> KeptViews:
        """Return its share of every view, in the memory of the whole."""
        return views.cut(self.channels, self.rows)

    def of_layers(self, layers: Tensor) -> Tensor:
        """Return its share of `[..., c, ly, lx]`, in the memory of the whole."""
        return layers[..., self.channels, self.beneath, :]


def pieces(projection: Projection, views: KeptViews, subframes: int = 1) -> Iterator[Piece]:
    """Divide views of any shape; on other devices than a processor they are one piece.

    Args:
        projection: where a row of views looks at rows that are not beside it, all rows are in one.
        views: what is divided.
        subframes: that are shown for each.
    """
    *batch, _, channels, height, width = views.stored.shape
    whole = Piece(slice(channels), slice(height), slice(None))
    if views.stored.device.type != "cpu":
        yield whole
        return
    most = max(1, _PIXELS * torch.get_num_threads() // (math.prod(batch) * subframes * width))
    bands = _even(height, min(height, most)) if projection.is_local else [whole.rows]
    reach = 2 * projection.margin[0]
    for part in _even(channels, max(1, most // height)):
        for rows in bands:
            beneath = slice(rows.start, rows.stop + reach) if projection.is_local else slice(None)
            yield Piece(part, rows, beneath)


def _even(length: int, most: int) -> list[slice]:
    """Divide a length into as few parts as can be, of nearly the same size."""
    count = -(-length // most)
    cuts = [length * n // count for n in range(count + 1)]
    return [slice(*ends) for ends in pairwise(cuts)]
