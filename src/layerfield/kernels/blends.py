"""Sums of what a step of ADMM is made of, in one pass over the layers."""

import math
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.compiled import compiled, serve

_NONE = np.zeros((0, 0, 0), np.float32)


class Shares(NamedTuple):
    """Of the iterate z = clamp(s), of the shadow s, and of what else there is."""

    iterate: float
    shadow: float
    other: float = 0.0


def blended(
    shares: Shares,
    shadow: Float[Tensor, "*batch ty tx"],
    bounds: tuple[float, float],
    other: Float[Tensor, "*batch ly lx"] | None = None,
    onto: Float[Tensor, "*batch ty tx"] | None = None,
) -> Float[Tensor, "*batch ty tx"]:
    """Return a z + b s + c other, with z = clamp(s).

    Args:
        shares: a, b and c.
        shadow: s.
        bounds: of z.
        other: planes that may be smaller: they lie in the top left corner.
        onto: to which all is added, in place.
    """
    if not serve(shadow, other, onto) or not (onto is None or onto.is_contiguous()):
        return _blended(shares, shadow, bounds, other, onto)
    (height, width), batch = shadow.shape[-2:], shadow.shape[:-2]
    if other is not None and (other.shape[-2] > height or other.shape[-1] > width):
        raise ValueError(f"found planes of {tuple(other.shape[-2:])}, expected {height, width}")
    result = torch.empty(shadow.shape) if onto is None else onto
    planes, seen = _planes(result), _planes(shadow.contiguous())
    added = _NONE if other is None else _planes(other.expand(*batch, -1, -1).contiguous())
    single, (low, high) = Shares._make(map(np.float32, shares)), map(np.float32, bounds)

    given = (planes, seen, added, single, low, high, onto is None)
    _blend.in_spans(*given, count=len(planes) * height, numbers=planes.size)
    return result


def _blended(
    shares: Shares,
    shadow: Tensor,
    bounds: tuple[float, float],
    other: Tensor | None,
    onto: Tensor | None,
) -> Tensor:
    iterate = shadow.clamp(*bounds)
    if onto is None:
        result = iterate.mul_(shares.iterate)
    else:
        result = onto.add_(iterate, alpha=shares.iterate)
    result.add_(shadow, alpha=shares.shadow)
    if other is not None:
        height, width = other.shape[-2:]
        result[..., :height, :width].add_(other, alpha=shares.other)
    return result


def _planes(values: Tensor) -> np.ndarray:
    *batch, height, width = values.shape
    return values.detach().view(math.prod(batch), height, width).numpy()


@compiled
def _blend(planes, shadows, others, shares, low, high, is_new, begin, end):
    """Rows of all planes, one after the other, from and to."""
    height = planes.shape[1]
    for number in range(begin, end):
        plane, y = number // height, number % height
        if is_new:
            _set(planes[plane, y], shadows[plane, y], shares, low, high)
        else:
            _add(planes[plane, y], shadows[plane, y], shares, low, high)
        if y < others.shape[1]:
            _add_other(planes[plane, y], others[plane, y], shares.other)


@compiled
def _set(row, shadow, shares, low, high):
    for x in range(len(row)):
        iterate = min(max(shadow[x], low), high)
        row[x] = shares.iterate * iterate + shares.shadow * shadow[x]


@compiled
def _add(row, shadow, shares, low, high):
    for x in range(len(row)):
        iterate = min(max(shadow[x], low), high)
        row[x] += shares.iterate * iterate + shares.shadow * shadow[x]


@compiled
def _add_other(row, other, share):
    for x in range(len(other)):
        row[x] += share * other[x]
