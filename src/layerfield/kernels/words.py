"""The normal equations of a grid of views in 16-bit words, for layers of pixels that stand alone.

Pixels are whole numbers from 0 to the largest whose sums over all views and layers are words. That
is more than panels show where views are not very many: 1310 for 5x5 views and three layers.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from layerfield.grid_system import Bands, GridSystem

WORDS = 32  # that go side by side; rows are as long as a multiple of them
_LARGEST, _LARGEST_LIGHT = 2**16 - 1, 2**15 - 1  # of sums, and of light that is multiplied
_FEWEST, _MOST = 255, 2**13 - 1  # of pixels: panels show so many; sums of four have a sign
_BITS = 16
_ONE = 2**_BITS  # what gains and powers are parts of
NOISE = 1021  # places where a row may begin in it


class Words(NamedTuple):
    """What compiled loops know of a grid; see `GridSystem`.

    Args:
        most: the pixel that stands for 1.
        weight: of a view.
        width: of a row of words.
        order: in which layers are swept.
        begins: `[direction, layer, other + 1]`, from which band to which; rows come first.
        offsets: `[direction, layer, band]`.
        steps: `[layer, other]`, rows from one band to the next; 0 where they differ.
        row_counts: `[layer, row]`, positions of viewers that see it.
        row_is_seen: `[layer, band, row]`, whether the row of the other layer is seen with it.
        masks: `[layer, band, column]`, all bits set where the other column is seen with it.
        halves: `[row count, layer, column]`; with the next two, see `_quotients`.
        gains: likewise, 0 where no view sees a pixel.
        powers: likewise.
        inner: `[row count, layer, 2]`, half and bits of columns that all positions see, see there.
        even: `[row count, layer, column]`, of 2^16 b, what every layer shows of it in the balanced
            start; 0 where no view sees a pixel.
        shares: `[layer, column]`, one over how many positions see it; 0 where none does.
        inside: `[direction, layer, 2]`, from which row to which all positions see rows, and from
            which word to which they see columns.
        reach: the farthest offsets, of rows and of columns.
        thresholds: noise, of a row and `NOISE` words more.
    """

    most: int
    weight: float
    width: int
    order: np.ndarray
    begins: np.ndarray
    offsets: np.ndarray
    steps: np.ndarray
    row_counts: np.ndarray
    row_is_seen: np.ndarray
    masks: np.ndarray
    halves: np.ndarray
    gains: np.ndarray
    powers: np.ndarray
    inner: np.ndarray
    even: np.ndarray
    shares: np.ndarray
    inside: np.ndarray
    reach: np.ndarray
    thresholds: np.ndarray


def words_of(system: GridSystem, weight: float) -> Words | None:
    """Return a grid in words, or None where words would be less than what panels show.

    Args:
        system: the normal equations.
        weight: of a view.
    """
    if not system.alone.all():
        return None
    sides = system.rows, system.columns
    counts = [each.coverage.astype(np.int64) for each in sides]  # whole, as shifts are
    views, layers = int(counts[0].max() * counts[1].max()), len(system.alone)
    most = min(_MOST, _LARGEST_LIGHT // views, _LARGEST // (views * max(layers - 1, 1)))
    if most < _FEWEST:
        return None
    pixels = counts[1].shape[1]
    width = -(-pixels // WORDS) * WORDS
    bands = max(each.offsets.shape[1] for each in sides)
    offsets = np.zeros((2, layers, bands), np.int64)
    for direction, each in enumerate(sides):
        offsets[direction, :, : each.offsets.shape[1]] = each.offsets
    masks = np.zeros((layers, bands, width), np.uint16)
    masks[:, : sides[1].shares.shape[1], :pixels] = np.where(sides[1].shares > 0, _LARGEST, 0)
    views_of = _views(counts[0], counts[1], width)
    halves, gains, powers = _quotients(views_of)
    return Words(
        most,
        weight,
        width,
        system.order,
        np.stack([each.begins for each in sides]),
        offsets,
        _steps(sides[0]),
        counts[0],
        sides[0].shares > 0,
        masks,
        halves,
        gains,
        powers,
        _inner_quotients(counts[0], counts[1]),
        _even(views_of),
        system.columns.gains,
        np.stack([sides[0].inside, _inside(sides[1], width)]),
        np.array([each.reach for each in sides]),
        np.random.default_rng(0).integers(2**16, size=width + NOISE, dtype=np.uint16),
    )


def _steps(rows: Bands) -> np.ndarray:
    """Return how many rows lie between one band and the next, or 0 where they lie otherwise."""
    number = len(rows.begins)
    made = np.zeros((number, number), np.int64)
    for k, j in np.ndindex(*made.shape):
        apart = np.diff(rows.offsets[k, rows.begins[k, j] : rows.begins[k, j + 1]])
        if len({*apart}) == 1:
            made[k, j] = apart[0]
    return made


def _views(rows: np.ndarray, columns: np.ndarray, width: int) -> np.ndarray:
    """Return how many views see a pixel, for every number of positions along y."""
    made = np.zeros((rows.max() + 1, len(columns), width), np.uint16)
    made[..., : columns.shape[1]] = np.arange(len(made))[:, None, None] * columns
    return made


def _quotients(views: np.ndarray) -> Sequence[np.ndarray]:
    """Return what tells x over n views, rounded, with two multiplications.

        (x + half) gain / 2^16,  power / 2^16 of that,  both rounded down,

    with power = 2^16 / 2^s, where n < 2^(s + 1) is the next power of two, and gain = 2^(16 + s) / n
    rounded up. It is exact for x < 2^15 and n < 2^7: see Granlund and Montgomery, "Division by
    invariant integers using multiplication", 1994. A factor of 2^16 is no word: 2^16 - 1 is the
    same of a number larger by one. Where there are no views power alone is 1.
    """
    number = views.astype(np.int64).clip(min=1)
    power = _ONE >> np.floor(np.log2(number)).astype(np.int64)
    gain = -(-_ONE * _ONE // (power * number))
    halves = number // 2 + (gain == _ONE) + (power == _ONE)
    found = halves, np.where(views > 0, gain, 0), np.where(views > 0, power, _ONE)
    return [each.clip(max=_ONE - 1).astype(np.uint16) for each in found]


def _inner_quotients(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return what tells quotients where all positions along x see a layer, beside their gain.

    In the place of a multiplication by power, its bits; nothing makes up for 2^16 - 1 then.
    """
    views = (np.arange(rows.max() + 1)[:, None] * columns.max(axis=1)).clip(min=1)
    bits = np.floor(np.log2(views)).astype(np.int64)
    is_power = views == 1 << bits  # of 2: the gain is 2^16
    return np.stack([views // 2 + is_power, bits], axis=-1)


def _even(views: np.ndarray) -> np.ndarray:
    """Return one over the number of views and of layers, in parts of 2^16."""
    number = views.astype(np.int64) * views.shape[1]
    shares = np.where(number > 0, np.rint(_ONE / number.clip(min=1)), 0)
    return shares.clip(max=_ONE - 1).astype(np.uint16)


def _inside(columns: Bands, width: int) -> np.ndarray:
    """Return from which word to which all positions see columns, by `WORDS`."""
    left, right = columns.inside.T
    begin, end = -(-left // WORDS) * WORDS, right // WORDS * WORDS
    return np.stack([begin, np.where(end > begin, end, begin)], axis=1).clip(max=width)
