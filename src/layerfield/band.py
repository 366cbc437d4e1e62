"""What layers contribute around the views: A^T (1 - M) W A, at the cost of the band alone.

View pixels of the torus that the mask M leaves out are a band: rows below the views, which the
torus joins to what is above them, and columns on their right. Layers are `[..., layer, c, *torus]`.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.compiled import serve
from layerfield.kernels.strips import Side, Sides, add_strips_, strips_of
from layerfield.projection import Projection, taps_of

Size = tuple[int, int]
Span = tuple[int, int]  # from, to; may run on past the end of the torus, at most once around
Kernel = tuple[tuple[int, float], ...]  # offsets in pixels, and weights
Bounds = tuple[float, float]

ANY = (-math.inf, math.inf)


@runtime_checkable
class Band(Protocol):
    """The band of a projection, views of one size and a torus."""

    def add_(
        self,
        result: Float[Tensor, "*batch layer c ty tx"],
        layers: Tensor,
        factor: float,
        bounds: Bounds = ANY,
    ) -> None:
        """Add a multiple of A^T (1 - M) W A of layers clamped to bounds, in place."""
        ...

    @property
    def sides(self) -> Sides | None:
        """What compiled loops find it with, or None where they do not serve."""
        ...


def band_of(projection: Projection, weights: Sequence[float], view_size: Size, torus: Size) -> Band:
    """Return the band: that of a grid of viewpoints where they are one, or else view by view.

    A single row of views is sooner looked at view by view.
    """
    axes = _axes(projection, view_size, torus)
    if axes is None or len({*weights}) > 1 or min(len(axis.shifts) for axis in axes) == 1:
        return ViewsBand(projection, tuple(weights), view_size, torus)
    return GridBand(*axes, weights[0])


@dataclass(frozen=True, eq=False)
class ViewsBand:
    """The band of any viewpoints: what each sees there, and back."""

    projection: Projection
    weights: tuple[float, ...]
    view_size: Size
    torus: Size

    @cached_property
    def _strips(self) -> list[tuple[Span, Span]]:
        """The layer pixels (rows, columns) that view pixels of the band look at.

        First all columns below the views, then what is left on their right.
        """
        (my, mx), (height, width), (ty, tx) = self.projection.margin, self.view_size, self.torus
        across = (0, tx + 2 * mx)
        strips = [((height, ty + 2 * my), across), ((0, height + 2 * my), (width, tx + 2 * mx))]
        return [
            (rows, columns)
            for rows, columns in strips
            if rows[1] - rows[0] > 2 * my and columns[1] - columns[0] > 2 * mx
        ]

    def add_(
        self,
        result: Float[Tensor, "*batch layer c ty tx"],
        layers: Tensor,
        factor: float,
        bounds: Bounds = ANY,
    ) -> None:
        """Add a multiple of A^T (1 - M) W A of layers clamped to bounds, in place."""
        weights = [weight * factor for weight in self.weights]
        for rows, columns in self._strips:
            strip = _cut(_cut(layers, rows, -2), columns, -1).clamp(*bounds)
            part = torch.zeros_like(strip)
            self.projection.add_normal_(part, strip, weights)
            for there, here in _wrapped(columns, self.torus[1]):
                _add_cut_(result[..., there], part[..., here], rows, -2)

    @property
    def sides(self) -> Sides | None:
        """Return None: what views see is added up in PyTorch."""
        return None


@dataclass(frozen=True)
class Axis:
    """One direction of a grid of viewpoints.

    Args:
        shifts: `[row or column of viewpoints][layer]`, pixels.
        margin: pixels by which layers exceed views on each side.
        views: pixels of a view.
        torus: pixels of the torus.
    """

    shifts: tuple[tuple[float, ...], ...]
    margin: int
    views: int
    torus: int

    @property
    def span(self) -> Span:
        """The layer pixels that view pixels of the band look at."""
        return self.views, self.torus + 2 * self.margin

    @cached_property
    def filters(self) -> list[list[Kernel]]:
        """`[to layer][from layer]` -> Y^T Y of all pixels: which ones to add up, relative."""
        layers = range(len(self.shifts[0]))
        return [[self._filter(to, come) for come in layers] for to in layers]

    @cached_property
    def side(self) -> Side:
        """The same and `matrices` as arrays."""
        count = range(len(self.filters))
        most = max(len(self.filters[to][come]) for to in count for come in count)
        offset = np.zeros((len(count), len(count), most), dtype=np.int64)
        weight = np.zeros(offset.shape, dtype=np.float32)
        for to in count:
            for come in count:
                for tap, known in enumerate(self.filters[to][come]):
                    offset[to, come, tap], weight[to, come, tap] = known
        return Side(self.span[0], self.matrices.float().numpy(), offset, weight)

    def _filter(self, to: int, come: int) -> Kernel:
        found: dict[int, float] = defaultdict(float)
        for shifts in self.shifts:
            for here, weight in taps_of(shifts[to]):
                for there, other in taps_of(shifts[come]):
                    found[there - here] += weight * other
        return tuple(sorted(found.items()))

    @cached_property
    def matrices(self) -> Float[Tensor, "layer layer n n"]:
        """`[to layer][from layer]` -> Y^T (1 - M) Y, on the span."""
        count, thick = len(self.shifts[0]), self.span[1] - self.span[0]
        result = torch.zeros(count, count, thick, thick, dtype=torch.float64)
        for shifts in self.shifts:
            looks = torch.zeros(count, self.torus - self.views, thick, dtype=torch.float64)
            for looking, shift in zip(looks, shifts, strict=True):
                for offset, weight in taps_of(shift):
                    looking.diagonal(self.margin + offset).add_(weight)
            result += looks.mT[:, None] @ looks
        return result


class GridBand:
    """The band of viewpoints on a grid that all count alike.

    Such views are A = Y X, each along its axis, and the band is all columns of the rows below, all
    rows of the columns on the right, less what is in both:

        Y^T (1 - M_y) Y  X^T X  +  Y^T Y  X^T (1 - M_x) X  -  Y^T (1 - M_y) Y  X^T (1 - M_x) X

    Across a strip that is a small matrix for every pair of layers, along it a filter of a few taps.

    Args:
        down: rows of viewpoints.
        across: columns of viewpoints.
        weight: of every view.
    """

    def __init__(self, down: Axis, across: Axis, weight: float) -> None:
        self._axes = down, across
        self._weight = weight
        self._kept: dict[tuple[torch.dtype, torch.device], tuple[Tensor, Tensor]] = {}

    def add_(
        self,
        result: Float[Tensor, "*batch layer c ty tx"],
        layers: Tensor,
        factor: float,
        bounds: Bounds = ANY,
    ) -> None:
        """Add a multiple of A^T (1 - M) W A of layers clamped to bounds, in place."""
        if serve(result, layers) and result.is_contiguous():
            add_strips_(result, strips_of(layers, self.sides, bounds).times(factor))
            return
        factor *= self._weight
        (down, across), (by_row, by_column) = self._axes, self._matrices(layers)
        rows = _cut(layers, down.span, -2).clamp(*bounds)
        columns = _cut(layers, across.span, -1).clamp(*bounds)
        corner = _cut(rows, across.span, -1)
        both = torch.einsum("lkab,...kcbd->...lkcad", by_row, corner)
        below = _strip(rows, by_row, across)
        _add_cut_(
            below, torch.einsum("lkde,...lkcae->...lcad", by_column, both).neg_(), across.span, -1
        )
        _add_cut_(result, below, down.span, -2, factor)
        beside = _strip(columns.mT.contiguous(), by_column, down)
        _add_cut_(result, beside.mT, across.span, -1, factor)

    @property
    def sides(self) -> Sides:
        """What compiled loops find it with."""
        down, across = self._axes
        return Sides(down.side, across.side, np.float32(self._weight))

    def _matrices(self, like: Tensor) -> tuple[Tensor, Tensor]:
        key = like.dtype, like.device
        if key not in self._kept:
            down, across = (axis.matrices.to(like) for axis in self._axes)
            self._kept[key] = down, across
        return self._kept[key]


def _strip(
    strip: Float[Tensor, "*batch layer c n along"],
    matrices: Float[Tensor, "layer layer n n"],
    axis: Axis,
) -> Float[Tensor, "*batch layer c n along"]:
    """Return what a strip comes to: matrices across it, the filters of an axis along it."""
    count, thick, length = len(matrices), strip.shape[-2], strip.shape[-1]
    reach = 2 * axis.margin
    around = torch.cat([strip[..., length - reach :], strip, strip[..., :reach]], dim=-1)
    planes, known = around.unbind(dim=-4), {}
    result = torch.empty_like(strip)
    seen = strip.new_empty(*strip.shape[:-4], strip.shape[-3], count * thick, length)
    for to in range(count):
        for come, plane in enumerate(planes):
            kernel = axis.filters[to][come]
            if (come, kernel) not in known:
                known[come, kernel] = _filtered(plane, kernel, reach, length)
            seen[..., come * thick : (come + 1) * thick, :] = known[come, kernel]
        across = matrices[to].transpose(0, 1).reshape(thick, count * thick)
        result[..., to, :, :, :] = across @ seen
    return result


def _filtered(plane: Tensor, kernel: Kernel, reach: int, length: int) -> Tensor:
    (first, share), *others = kernel
    result = plane[..., reach + first : reach + first + length] * share
    for offset, weight in others:
        result.add_(plane[..., reach + offset : reach + offset + length], alpha=weight)
    return result


def _axes(projection: Projection, view_size: Size, torus: Size) -> tuple[Axis, Axis] | None:
    """Return both directions of the viewpoints if they are a grid, each of them once."""
    seen = [tuple(zip(*layers, strict=True)) for layers in projection.shifts]
    across, down = (tuple(dict.fromkeys(places)) for places in zip(*seen, strict=True))
    if len({*seen}) != len(seen) or len(seen) != len(across) * len(down):
        return None
    axes = zip((down, across), projection.margin, view_size, torus, strict=True)
    first, second = (Axis(*facts) for facts in axes)
    return first, second


def _cut(values: Tensor, span: Span, dim: int) -> Tensor:
    """Return a span of a torus that may run on past its end, at most once around."""
    start, stop = span
    length = values.shape[dim]
    if stop <= length:
        return values.narrow(dim, start, stop - start)
    tail, head = values.narrow(dim, start, length - start), values.narrow(dim, 0, stop - length)
    return torch.cat([tail, head], dim)


def _add_cut_(result: Tensor, part: Tensor, span: Span, dim: int, factor: float = 1.0) -> None:
    """Add a multiple of what `_cut` took back to where it came from; its adjoint, in place."""
    for there, here in _wrapped(span, result.shape[dim]):
        target = result.narrow(dim, there.start, there.stop - there.start)
        target.add_(part.narrow(dim, here.start, here.stop - here.start), alpha=factor)


def _wrapped(span: Span, length: int) -> list[tuple[slice, slice]]:
    """Return where the parts of a span lie on a torus, and in what was cut out."""
    start, stop = span
    before = min(stop, length) - start
    found = [(slice(start, start + before), slice(0, before))]
    if stop > length:
        found.append((slice(0, stop - length), slice(before, stop - start)))
    return found
