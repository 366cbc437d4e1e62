"""Where the light paths of pixels lead, where they go through whole pixels: offsets in bytes."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from layerfield.projection import Projection

EDGE = 8  # pixels that stand side by side where not all views look
AHEAD = 8  # views, from when what one shows is fetched to when it is its turn
_FLOAT = 4  # bytes of a pixel of layers


class Light(NamedTuple):
    """Views of one size: rows and columns, channels, bytes of a number."""

    size: tuple[int, int]
    channels: int
    bytes: int


class PathTables(NamedTuple):
    """By layer, and by view that has a weight.

    Args:
        which: `[view]`, which one it is.
        weight: `[view]`.
        top: `[layer, view]`, the row of the layer that its first one looks at.
        left: `[layer, view]`, the column.
        light: `[layer, view]`, bytes from row y of the first view to what this one shows where
            column 0 of row y of the layer looks; then as many zeros as are fetched ahead.
        others: `[layer, view, other]`, bytes from there in the layer to there in the other ones.
        inner: `[layer, 4]`, from which row to which all views look, and what they show may be read
            past the ends of rows; from which column to which all look.
        reach: how many rows up or down a pixel of a layer looks.
        order: in which layers are swept.
    """

    which: np.ndarray
    weight: np.ndarray
    top: np.ndarray
    left: np.ndarray
    light: np.ndarray
    others: np.ndarray
    inner: np.ndarray
    reach: int
    order: np.ndarray


@lru_cache(maxsize=16)
def tables_of(projection: Projection, weights: tuple[float, ...], light: Light) -> PathTables:
    """Return the tables of a display whose layers and views lie in memory without gaps.

    Args:
        projection: A, of whole pixels.
        weights: of the views; those of none are left out.
        light: the views.
    """
    height, width = light.size
    rows, columns = (n + 2 * more for n, more in zip(light.size, projection.margin, strict=True))
    which = np.flatnonzero(weights)
    begins = np.array([[taps[0][:2] for taps in layers] for layers in projection.taps])
    top, left = (np.ascontiguousarray(begins[which, :, n].T) for n in range(2))
    number = len(top)
    depth = np.arange(number)[:, None] * light.channels * rows
    there = ((depth + top) * columns + left) * _FLOAT  # [layer, view]
    rest = [[j for j in range(number) if j != k] for k in range(number)]
    others = np.array([(there[each] - there[k]).T for k, each in enumerate(rest)])
    seen = (which * light.channels * height - top) * width - left
    before = -(-left // width)
    behind = -(-(columns + EDGE - left) // width) - 1
    inner = [
        (top + before).max(axis=1, initial=0),
        (top + height - behind).min(axis=1, initial=rows),
        left.max(axis=1, initial=0),
        (left + width).min(axis=1, initial=columns),
    ]
    return PathTables(
        which,
        np.asarray(weights, np.float32)[which],
        top,
        left,
        np.pad(seen * light.bytes, ((0, 0), (0, AHEAD))),
        np.ascontiguousarray(others),
        np.stack(inner, axis=1),
        int(np.ptp(begins[..., 0], axis=1).max()),
        np.array(projection.inner_first),
    )
