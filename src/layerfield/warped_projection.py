"""A for eyes at any distance: a view meets every layer under a magnification of its own.

    (A P)_i(x) = sum_k P_k(m_ik x + d_ik)       x counted from the centre, linear interpolation

Rows and columns are resampled one after the other. Along either, most neighbouring pixels of a view
look at neighbouring pixels of the layer: m near 1 makes a few runs of them, each a plain window
whose fraction grows from pixel to pixel.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.geometry import Geometry, Point
from layerfield.projection import Projection

_OUTSIDE = 1e-6  # pixels by which rounding may carry a light path past the last pixel


@dataclass(frozen=True)
class WarpedProjection(Projection):
    """A for one set of shifts and magnifications; the interface of `Projection`.

    Its Gram matrix is no small matrix per frequency; that of `shifts_only` is near it.

    Args:
        shifts: `[view][layer] = (x, y)` in pixels.
        margin: pixels (y, x) by which layers exceed views on each side; no light path may leave
            them.
        magnifications: `[view][layer]`.
    """

    magnifications: tuple[tuple[float, ...], ...]

    @property
    def is_local(self) -> bool:
        return False

    @cached_property
    def is_whole(self) -> bool:
        return False

    @property
    def shifts_only(self) -> Projection:
        return Projection(self.shifts, self.margin)

    def window(
        self, layer: Float[Tensor, "*batch ly lx"], view: int, index: int
    ) -> Float[Tensor, "*batch y x"]:
        rows, columns = self._runs(view, index, self.view_size(layer))
        return _resample(_resample(layer, rows, -2), columns, -1)

    def scatter_(
        self,
        layer: Float[Tensor, "*batch ly lx"],
        values: Tensor,
        view: int,
        index: int,
        factor: float = 1.0,
    ) -> None:
        size = (values.shape[-2], values.shape[-1])
        rows, columns = self._runs(view, index, size)
        wide = values.new_zeros(*values.shape[:-1], layer.shape[-1])
        _spread_(wide, values, columns, -1)
        _spread_(layer, wide.mul_(factor), rows, -2)

    def symbol(self, size: tuple[int, int], weights: Sequence[float]) -> Tensor:
        raise ValueError(
            "viewpoints at different distances have no Fourier solution; take the method "
            "fourier-admm, which starts from the nearest one, or sweeps, gradient or sart"
        )

    def _runs(
        self, view: int, index: int, size: tuple[int, int]
    ) -> tuple[tuple["_Run", ...], tuple["_Run", ...]]:
        (x, y), m = self.shifts[view][index], self.magnifications[view][index]
        return _runs(m, y, size[0], self.margin[0]), _runs(m, x, size[1], self.margin[1])


def projection_of(geometry: Geometry) -> Projection:
    """Return A of a geometry, in its simplest form."""
    return project(geometry.shifts, geometry.magnifications, geometry.margin)


def project(
    shifts: tuple[tuple[Point, ...], ...],
    magnifications: tuple[tuple[float, ...], ...],
    margin: tuple[int, int],
) -> Projection:
    """Return A of shifts and magnifications: pure shifts where all magnifications are 1."""
    if all(m == 1 for view in magnifications for m in view):
        return Projection(shifts, margin)
    return WarpedProjection(shifts, margin, magnifications)


class _Run(NamedTuple):
    """Pixels of a view along an axis that look at as many neighbouring ones of a layer.

    Args:
        first: pixel of the view,
        last: the pixel after the last.
        start: where `first` looks at in the layer.
        fraction: how far each looks past its pixel of the layer, 0 to 1; None where all are 0.
    """

    first: int
    last: int
    start: int
    fraction: Float[Tensor, " n"] | None


@lru_cache(maxsize=4096)
def _runs(magnification: float, shift: float, length: int, margin: int) -> tuple[_Run, ...]:
    centre, last = (length - 1) / 2, length + 2 * margin - 1
    places = torch.arange(length, dtype=torch.float64).sub_(centre).mul_(magnification)
    places += centre + margin + shift
    if places[0] < -_OUTSIDE or places[-1] > last + _OUTSIDE:
        raise ValueError(
            f"a light path meets pixel {max(-places[0], places[-1] - last):.1f} past the end of a "
            "layer; give layers a wider margin"
        )
    whole = places.floor().clamp_(0, max(last - 1, 0))
    steps = (whole.diff() != 1).nonzero().flatten() + 1
    bounds = [0, *steps.tolist(), length]
    fractions = places - whole
    return tuple(
        _Run(a, b, int(whole[a]), f if (f := fractions[a:b]).abs().max() > 1e-9 else None)
        for a, b in pairwise(bounds)
    )


def _resample(layer: Tensor, runs: tuple[_Run, ...], dim: int) -> Tensor:
    parts = []
    for first, last, start, fraction in runs:
        part = layer.narrow(dim, start, last - first)
        if fraction is not None:
            beyond = layer.narrow(dim, start + 1, last - first)
            part = torch.lerp(part, beyond, _along(fraction, layer, dim))
        parts.append(part)
    return parts[0] if len(parts) == 1 else torch.cat(parts, dim)


def _spread_(layer: Tensor, values: Tensor, runs: tuple[_Run, ...], dim: int) -> None:
    """Add values to a layer where `_resample` took them from; its adjoint, in place."""
    for first, last, start, fraction in runs:
        part, near = values.narrow(dim, first, last - first), layer.narrow(dim, start, last - first)
        if fraction is None:
            near.add_(part)
            continue
        weight = _along(fraction, layer, dim)
        near.addcmul_(part, 1 - weight)
        layer.narrow(dim, start + 1, last - first).addcmul_(part, weight)


def _along(fraction: Tensor, like: Tensor, dim: int) -> Tensor:
    weight = fraction.to(like)
    return weight if dim == -1 else weight[:, None]


def reach(shift: float, magnification: float, length: int) -> int:
    """Return the pixels by which light paths go past views of this length, 0 or more."""
    return max(math.ceil(abs(shift) + (magnification - 1) * (length - 1) / 2 - _OUTSIDE), 0)


def nearest(shift: float, magnification: float, length: int, margin: int) -> float:
    """Return the shift, or where it carries a view past its layer altogether, the least that does.

    Either way the view sees the same.
    """
    least = (magnification * length + length) / 2 + margin + 1
    return min(max(shift, -least), least)
