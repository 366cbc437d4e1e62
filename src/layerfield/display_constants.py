"""What depends on a display and the size of its views alone, kept for the next light field."""

from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.gram import Gram
from layerfield.projection import Projection

_KEPT = 3  # displays and sizes; more would rather fill the memory than save time


def gram_of(
    projection: Projection, weights: tuple[float, ...], view_size: tuple[int, int], like: Tensor
) -> Gram:
    """Return A^T M W A; arguments as for `Gram`."""
    return _gram(projection, weights, view_size, like.dtype, like.device)


def coverage_of(
    projection: Projection, weights: tuple[float, ...], view_size: tuple[int, int], like: Tensor
) -> Float[Tensor, "layer 1 ly lx"]:
    """Return A^T W 1, the weight of the views that see a layer pixel, not to be written on."""
    return _coverage(projection, weights, view_size, like.dtype, like.device)


def even_shares_of(
    projection: Projection, weights: tuple[float, ...], view_size: tuple[int, int], like: Tensor
) -> Float[Tensor, "layer 1 ly lx"]:
    """Return what A^T W L is multiplied by for the balanced start, 1 / (K A^T W 1).

    Where nobody looks that is 0.
    """
    return _even_shares(projection, weights, view_size, like.dtype, like.device)


def forget_constants() -> None:
    """Keep nothing any more, so that the memory of what follows is its own."""
    for kept in (_gram, _coverage, _even_shares):
        kept.cache_clear()


@lru_cache(maxsize=_KEPT)
def _gram(
    projection: Projection,
    weights: tuple[float, ...],
    view_size: tuple[int, int],
    dtype: torch.dtype,
    device: torch.device,
) -> Gram:
    with torch.inference_mode(False):  # what is kept must serve training, too
        return Gram(projection, weights, view_size, torch.empty(0, dtype=dtype, device=device))


@lru_cache(maxsize=_KEPT)
def _coverage(
    projection: Projection,
    weights: tuple[float, ...],
    view_size: tuple[int, int],
    dtype: torch.dtype,
    device: torch.device,
) -> Tensor:
    with torch.inference_mode(False):
        ones = torch.ones(1, *view_size, dtype=dtype, device=device)
        layers = ones.new_zeros(len(projection.shifts[0]), 1, *projection.layer_size(ones))
        for i, weight in enumerate(weights):
            for k, layer in enumerate(layers):
                projection.scatter_(layer, ones, i, k, weight)
        return layers


@lru_cache(maxsize=_KEPT)
def _even_shares(
    projection: Projection,
    weights: tuple[float, ...],
    view_size: tuple[int, int],
    dtype: torch.dtype,
    device: torch.device,
) -> Tensor:
    coverage = _coverage(projection, weights, view_size, dtype, device)
    with torch.inference_mode(False):
        shares = 1 / (len(coverage) * coverage.clamp(min=1e-6 * sum(weights)))
        return shares.masked_fill_(coverage <= 0, 0)
