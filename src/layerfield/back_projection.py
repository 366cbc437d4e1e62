"""A^T W L, all that a sum link needs to know of the views, from views of 8 bit."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float, UInt16
from torch import Tensor

from layerfield.kept_views import LARGEST, KeptViews
from layerfield.kernels import code_sums
from layerfield.kernels.gpu.serving import on_gpu
from layerfield.kernels.light_paths import LightPaths, Shares
from layerfield.kernels.seen_words import words_of_codes, words_of_light
from layerfield.kernels.words import Words
from layerfield.links import Additive
from layerfield.pieces import pieces
from layerfield.projection import Projection

_SUM = Additive()
_MOST = {torch.int16: 2**15 - 1, torch.int32: 2**31 - 1}  # the largest sums they hold


def back_projected(
    projection: Projection, views: KeptViews, weights: Sequence[float]
) -> Float[Tensor, "*batch layer c ly lx"]:
    """Return A^T W L; every view is read once, and no others are floats meanwhile.

    Where light paths meet layers at whole pixels and all views count alike, codes are summed up as
    the whole numbers they are: exact, and half the bytes of floats to move.

    Args:
        projection: A.
        views: L.
        weights: W, one for every view.
    """
    held = _held_by(projection, views, weights)
    if held is not None and not on_gpu(views.like):
        return _summed(projection, views, held, weights[0])
    layers = _none(projection, views, views.like.dtype)
    alone = layers.unsqueeze(-5)  # the only subframe
    paths = LightPaths(projection, _SUM, views, weights)
    if paths.serve(alone):
        paths.add_up_(alone, alone, shares=Shares(0, 1))
        return layers
    for piece in pieces(projection, views):
        seen, part = piece.of_views(views), piece.of_layers(layers).unbind(dim=-4)
        for i, weight in enumerate(weights):
            view = seen.view(i)
            for k, layer in enumerate(part):
                projection.scatter_(layer, view, i, k, weight)
    return layers


def back_projected_words(
    projection: Projection, views: KeptViews, weights: Sequence[float], words: Words
) -> UInt16[Tensor, "*batch layer c ly words"]:
    """Return the same in 16-bit words, on a processor; codes become no floats.

    Args:
        projection: A.
        views: L, from 0 to 1.
        weights: W, one for every view.
        words: the normal equations.
    """
    held = _held_by(projection, views, weights)
    if held is None or not code_sums.serve(views.stored):
        return words_of_light(back_projected(projection, views, weights), words)
    return words_of_codes(_codes(projection, views, held, weights[0]), words)


def _held_by(
    projection: Projection, views: KeptViews, weights: Sequence[float]
) -> torch.dtype | None:
    """Return whole numbers that hold the sums of codes, where all that is asked for are those."""
    whole = projection.is_whole and views.is_whole and views.table is None
    if not whole or len({*weights}) > 1:
        return None
    most = LARGEST[views.stored.dtype] * len(views)
    return next((dtype for dtype, largest in _MOST.items() if most <= largest), None)


def _codes(
    projection: Projection, views: KeptViews, dtype: torch.dtype, weight: float
) -> code_sums.Codes:
    """Return what compiled loops add up."""
    size, unit = projection.layer_size(views.stored), weight / LARGEST[views.stored.dtype]
    return code_sums.Codes(views.stored, _paths_of(projection), size, dtype, unit)


@lru_cache
def _paths_of(projection: Projection) -> code_sums.Paths:
    offsets = [[taps[0][:2] for taps in layers] for layers in projection.taps]
    return code_sums.paths_of(np.array(offsets))


def _summed(projection: Projection, views: KeptViews, dtype: torch.dtype, weight: float) -> Tensor:
    """A^T of codes for shifts of whole pixels, in whole numbers, then of what they stand for."""
    if code_sums.serve(views.stored):
        return code_sums.code_sums(_codes(projection, views, dtype, weight))
    layers = _none(projection, views, dtype)
    for piece in pieces(projection, views):
        codes, part = piece.of_views(views).stored, piece.of_layers(layers).unbind(dim=-4)
        height, width = codes.shape[-2:]
        for view, taps in zip(codes.unbind(dim=-4), projection.taps, strict=True):
            wide = view.to(dtype)
            for layer, ((top, left, _),) in zip(part, taps, strict=True):
                layer[..., top : top + height, left : left + width].add_(wide)
    return layers.to(torch.float32).mul_(weight).div_(LARGEST[views.stored.dtype])


def _none(projection: Projection, views: KeptViews, dtype: torch.dtype) -> Tensor:
    """Zeros for layers of these views."""
    *batch, _, channels, _, _ = views.stored.shape
    shape = (*batch, len(projection.shifts[0]), channels, *projection.layer_size(views.stored))
    return torch.zeros(shape, dtype=dtype, device=views.stored.device)
