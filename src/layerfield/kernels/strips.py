"""Strips of layers: small matrices across them, filters of a few taps along them."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.compiled import compiled
from layerfield.kernels.threads import in_threads


class Filters(NamedTuple):
    """`[to layer, from layer, tap]`: pixels around a circle, and weights; unused ones are 0."""

    offset: np.ndarray
    weight: np.ndarray


def across_and_along(
    strip: Float[Tensor, "*batch layer c n along"],
    matrices: Float[Tensor, "layer layer n n"],
    filters: Filters,
) -> Float[Tensor, "*batch layer c n along"]:
    """Return for every layer the sum over layers of a matrix times a filtered strip."""
    result = torch.zeros(strip.shape)
    number, channels = strip.shape[-4:-2]
    seen, made = (each.view(-1, *strip.shape[-4:]).numpy() for each in (strip.contiguous(), result))
    across = matrices.numpy()

    def task(place: int) -> None:
        item, rest = divmod(place, channels * number)
        _add_layer(made, seen, across, filters, (item, *divmod(rest, number)))

    in_threads(task, len(made) * channels * number)
    return result


@compiled
def _add_layer(result, strip, matrices, filters, place):
    item, channel, to = place
    number, thick, length = strip.shape[1], strip.shape[3], strip.shape[4]
    filtered = np.zeros((thick, length), strip.dtype)
    for come in range(number):
        for b in range(thick):
            for tap in range(filters.offset.shape[2]):
                offset, weight = filters.offset[to, come, tap], filters.weight[to, come, tap]
                row, turn = strip[item, come, channel, b], offset % length
                if tap == 0:
                    _set(filtered[b, : length - turn], row[turn:], weight)
                    _set(filtered[b, length - turn :], row[:turn], weight)
                elif weight != 0:
                    _add(filtered[b, : length - turn], row[turn:], weight)
                    _add(filtered[b, length - turn :], row[:turn], weight)
        for a in range(thick):
            for b in range(thick):
                if matrices[to, come, a, b] != 0:  # most of them: pixels that no view joins
                    _add(result[item, to, channel, a], filtered[b], matrices[to, come, a, b])


@compiled
def _set(row, other, weight):
    for x in range(len(row)):
        row[x] = weight * other[x]


@compiled
def _add(row, other, weight):
    for x in range(len(row)):
        row[x] += weight * other[x]
