"""A^T W L in 16-bit words, for sweeps over layers in words; see `word_sweeps`."""

import numpy as np
import torch
from jaxtyping import Float, UInt16
from torch import Tensor

from layerfield.kernels.blends import planes_of
from layerfield.kernels.code_sums import Codes, ask_for_next, sum_row
from layerfield.kernels.compiled import compiled, native
from layerfield.kernels.words import Words

_BRIGHTEST = np.float32(2**15 - 1)  # the light of all views together
_sums_to_light = native("layerfield.kernels.code_lanes", "to_light")
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
    sums, found = np.zeros(width, held.dtype), np.empty(paths.views.shape[1], np.int64)
    light = np.empty(width, np.float32)
    for place in range(begin, end):
        item, rest = divmod(place, channels * height)
        channel, row = divmod(rest, height)
        ask_for_next(views, paths, (item, channel, row))
        for k in range(number):
            sum_row(sums, found, views, paths, (item, channel, k, row))
            own = light.ctypes.data
            _sums_to_light(sums, own, sums.ctypes.data, units[0], units[1], width)
            there = ((item * number + k) * channels + channel) * height + row
            _to_words((made.ctypes.data + 2 * there * words,), own, share, _BRIGHTEST, width)
