"""Sums of what a step of ADMM is made of, in one pass over the layers."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Num
from torch import Tensor

from layerfield.kernels.compiled import compiled, serve
from layerfield.kernels.gpu.serving import on_gpu
from layerfield.kernels.strips import NO_STRIPS, Strips, add_strips_to_row

_NONE = np.zeros((0, 0, 0), np.float32)


class Shares(NamedTuple):
    """Of the iterate z = clamp(s), of the shadow s, and of what else there is."""

    iterate: float
    shadow: float
    other: float = 0.0


@dataclass(frozen=True, eq=False)
class Blend:
    """a z + b s + c other, with z = clamp(s): planes that nobody has added up yet.

    Args:
        shares: a, b and c.
        shadow: s.
        bounds: of z.
        other: planes that may be smaller: they lie in the top left corner.
        strips: what else is added to rows below and columns beside them, c times, too. They are
            there for compiled loops only.
    """

    shares: Shares
    shadow: Float[Tensor, "*batch ty tx"]
    bounds: tuple[float, float]
    other: Float[Tensor, "*batch ly lx"] | None = None
    strips: Strips | None = None

    def planes(
        self, onto: Float[Tensor, "*batch ty tx"] | None = None
    ) -> Float[Tensor, "*batch ty tx"]:
        """Return the sum, added to what is given, in place."""
        if not self.serves(onto):
            return self._in_pytorch(onto)
        result = torch.empty(self.shadow.shape, dtype=torch.float32) if onto is None else onto
        made = planes_of(result)
        given = (made, self.sum(), onto is None)
        _blend.in_spans(*given, count=len(made) * made.shape[1], numbers=made.size)
        return result

    def serves(self, onto: Tensor | None = None) -> bool:
        """Whether compiled loops do."""
        known = serve(self.shadow, self.other, onto)
        return known and (onto is None or onto.is_contiguous())

    def sum(self) -> "Sum":
        """Return the same for compiled loops."""
        height, batch = self.shadow.shape[-2], self.shadow.shape[:-2]
        added = _NONE if self.other is None else corners_of(self.other, self.shadow.shape)
        strips = NO_STRIPS if self.strips is None else self.strips.times(self.shares.other)
        if strips is not NO_STRIPS and strips.beside.shape[:2] != (math.prod(batch), height):
            raise ValueError(f"found strips of {strips.beside.shape[:2]}, expected {batch, height}")
        shares, bounds = (map(np.float32, each) for each in (self.shares, self.bounds))
        shadow = planes_of(self.shadow.contiguous())
        return Sum(shadow, added, strips, Shares._make(shares), *bounds)

    def _in_pytorch(self, onto: Tensor | None) -> Tensor:
        if on_gpu(self.shadow, onto) and (self.other is None or on_gpu(self.other.detach())):
            from layerfield.kernels.gpu.blends import blend_  # noqa: PLC0415  needs Triton

            result = torch.empty_like(self.shadow) if onto is None else onto
            given = self.shares, self.shadow, self.bounds, self.other
            blend_(result, *given, onto=onto is not None)
            return result
        shares, iterate = self.shares, self.shadow.clamp(*self.bounds)
        if onto is None:
            result = iterate.mul_(shares.iterate)
        else:
            result = onto.add_(iterate, alpha=shares.iterate)
        result.add_(self.shadow, alpha=shares.shadow)
        if self.other is not None:
            height, width = self.other.shape[-2:]
            result[..., :height, :width].add_(self.other, alpha=shares.other)
        return result


class Sum(NamedTuple):
    """A `Blend` of `[plane, y, x]`; what there is not has no planes."""

    shadow: np.ndarray
    other: np.ndarray
    strips: Strips
    shares: Shares
    low: np.float32
    high: np.float32


_ZERO: Any = np.float32(0)  # as all others are: whole numbers would be another type
NOTHING = Sum(_NONE, _NONE, NO_STRIPS, Shares(_ZERO, _ZERO, _ZERO), _ZERO, _ZERO)


def corners_of(other: Float[Tensor, "*batch ly lx"], shape: Sequence[int]) -> np.ndarray:
    """Return what lies in the top left corner of planes, as `[plane, y, x]`.

    Args:
        other: of as many planes, or of one for several.
        shape: of the planes.

    Raises:
        ValueError: it is larger.
    """
    *batch, height, width = shape
    if other.shape[-2] > height or other.shape[-1] > width:
        found = tuple(other.shape[-2:])
        raise ValueError(f"found planes of {found}, expected {height, width}")
    return planes_of(other.expand(*batch, -1, -1).contiguous())


def planes_of(values: Num[Tensor, "*batch y x"]) -> np.ndarray:
    """Return contiguous values as `[plane, y, x]`."""
    *batch, height, width = values.shape
    return values.detach().view(math.prod(batch), height, width).numpy()


@compiled
def _blend(planes, known, is_new, begin, end):
    """Rows of all planes, one after the other, from and to."""
    for number in range(begin, end):
        plane, y = divmod(number, planes.shape[1])
        blend_row(planes[plane, y], known, plane, y, is_new)


@compiled
def blend_row(row, known, plane, y, is_new):
    """Put the sum into a row of a plane, or add it to what is there."""
    if not shows_layers(known):
        if is_new:
            row[:] = 0
    elif is_new:
        _set(row, known.shadow[plane, y], known.shares, known.low, known.high)
    else:
        _add(row, known.shadow[plane, y], known.shares, known.low, known.high)
    if y < known.other.shape[1]:
        _add_other(row, known.other[plane, y], known.shares.other)
    if len(known.strips.below) > 0:
        add_strips_to_row(row, known.strips, plane, y)


@compiled
def shows_layers(known):
    """Whether layers are a part of the sum at all."""
    return known.shares.iterate != 0 or known.shares.shadow != 0


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
