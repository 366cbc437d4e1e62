"""A^T W L in 16-bit words, for sweeps over layers in words; see `word_sweeps`."""

import numpy as np
import torch
from jaxtyping import Float, Float64, UInt16
from torch import Tensor

from layerfield.kernels.blends import planes_of
from layerfield.kernels.code_sums import Codes, room_for_rows, sum_row
from layerfield.kernels.compiled import compiled, native
from layerfield.kernels.words import Words

_BRIGHTEST = np.float32(2**15 - 1)  # the light of all views together
_sums_to_words = native("layerfield.kernels.code_lanes", "to_words")
_to_words = native("layerfield.kernels.word_lanes", "to_words")


def words_of_light(
    seen: Float[Tensor, "*batch layer c ly lx"], words: Words
) -> UInt16[Tensor, "*batch layer c ly words"]:
    """Return words of b; those beyond the last pixel are what was in memory.

    Args:
        seen: b, of views from 0 to 1; of single precision, on a processor.
        words: the normal equations.
    """
    made = torch.empty((*seen.shape[:-1], words.width), dtype=torch.uint16)
    both = planes_of(made), planes_of(seen.contiguous()), _share(words)
    _convert_rows.in_spans(*both, count=seen[..., 0].numel(), numbers=seen.numel())
    return made


def words_of_codes(codes: Codes, words: Words) -> UInt16[Tensor, "*batch layer c ly words"]:
    """Return the same of codes, without a picture of floats between."""
    made = codes.none(words.width, torch.uint16)
    codes.add_(_add_rows.in_spans, made, codes.layer_size[1], _share(words))
    return made


def light_of_words(
    seen: UInt16[Tensor, "*batch layer c ly words"], width: int
) -> Float64[np.ndarray, "item c"]:
    """Return the sum of the first layer's words, of so many pixels of a row."""
    planes = seen.view(-1, *seen.shape[-4:]).numpy()
    made = np.zeros((planes.shape[0], planes.shape[2]))
    _add_up(made, planes, width)
    return made


def _share(words: Words) -> np.float32:
    return np.float32(words.most / words.weight)


@compiled
def _convert_rows(made, seen, share, begin, end):
    """Rows of all planes, one after the other, from and to."""
    width = seen.shape[2]
    for n in range(begin, end):
        to = made.ctypes.data + 2 * n * made.shape[2]
        _to_words((to,), seen.ctypes.data + 4 * n * width, share, _BRIGHTEST, width)


@compiled
def _add_rows(made, views, paths, held, units, width, share, begin, end):
    """Rows of the layers, all layers together, channel by channel, from and to."""
    number, channels, height, words = made.shape[1:]
    sums, found = room_for_rows(paths, width, held)
    factor = np.float32((np.float64(units[0]) + np.float64(units[1])) * np.float64(share))
    for place in range(begin, end):
        item, rest = divmod(place, channels * height)
        channel, row = divmod(rest, height)
        for k in range(number):
            sum_row(sums, found, views, paths, (item, channel, k, row))
            there = ((item * number + k) * channels + channel) * height + row
            to = made.ctypes.data + 2 * there * words
            _sums_to_words(sums, to, sums.ctypes.data, factor, _BRIGHTEST, width)


@compiled
def _add_up(made, planes, width):
    """Sums over the first layer."""
    for item in range(planes.shape[0]):
        for channel in range(planes.shape[2]):
            for y in range(planes.shape[3]):
                row, total = planes[item, 0, channel, y], np.uint32(0)
                for x in range(width):
                    total += np.uint32(row[x])
                made[item, channel] += total
