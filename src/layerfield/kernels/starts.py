"""The balanced start of a solver, in one pass."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Num
from torch import Tensor

from layerfield.kernels.blends import planes_of
from layerfield.kernels.compiled import compiled
from layerfield.kernels.strips import Side, Sides


class Even(NamedTuple):
    """What makes the balanced start of what is seen; see `shared_start`.

    Args:
        shares: `[layer, ly, lx]`.
        rest: `[item, channel]`.
    """

    shares: np.ndarray
    rest: np.ndarray


def even_of(
    seen: Num[Tensor, "*batch layer c ly lx"],
    shares: Float[Tensor, "layer 1 ly lx"],
    rest: Float[Tensor, "*batch 1 c 1 1"],
) -> Even:
    """Return the same for compiled loops.

    Raises:
        ValueError: shares of other layers.
    """
    *batch, number, channels, height, width = seen.shape
    if shares.shape != (number, 1, height, width):
        raise ValueError(f"found shares {tuple(shares.shape)}, expected {number, 1, height, width}")
    others = rest.detach().expand(*batch, 1, channels, 1, 1).contiguous().view(-1, channels)
    return Even(shares.contiguous().view(number, height, width).numpy(), others.numpy())


def shared_start(
    seen: Float[Tensor, "*batch layer c ly lx"],
    shares: Float[Tensor, "layer 1 ly lx"],
    rest: Float[Tensor, "*batch 1 c 1 1"],
    size: tuple[int, int],
) -> Float[Tensor, "*batch layer c ty tx"]:
    """Return shares of what is seen, on a torus whose other pixels are 0.

    Args:
        seen: of single precision, on a processor.
        shares: what to multiply it by; where that is 0
        rest: is taken.
        size: height and width of the torus, no smaller than the layers.
    """
    even, result = even_of(seen, shares, rest), _torus_of(seen, size)
    made, known = planes_of(result), planes_of(seen.contiguous())
    _share.in_spans(made, known, even, count=len(made) * size[0], numbers=made.size)
    return result


def shared_rim(
    seen: Float[Tensor, "*batch layer c ly lx"],
    shares: Float[Tensor, "layer 1 ly lx"],
    rest: Float[Tensor, "*batch 1 c 1 1"],
    size: tuple[int, int],
    sides: Sides,
) -> Float[Tensor, "*batch layer c ty tx"]:
    """Return the rows and columns of a `shared_start` that strips are found of.

    The other pixels are not written on: they are what was in memory.
    """
    even, result = even_of(seen, shares, rest), _torus_of(seen, size)
    made, known, (down, across, _) = planes_of(result), planes_of(seen.contiguous()), sides
    _share_rims.in_spans(made, known, even, down, across, count=len(made), numbers=made.size)
    return result


def _torus_of(seen: Tensor, size: tuple[int, int]) -> Tensor:
    *batch, height, width = seen.shape
    if size[0] < height or size[1] < width:
        raise ValueError(f"found a torus {size}, expected no smaller one than {(height, width)}")
    return torch.empty((*batch, *size), dtype=torch.float32)


@compiled
def _share_rims(result, seen, even, down, across, begin, end):
    """Those of planes from and to."""
    for plane in range(begin, end):
        share_rim(result[plane], seen, even, plane, down, across)


@compiled
def _share(result, seen, even, begin, end):
    """Rows of all planes, one after the other, from and to."""
    rows, width = result.shape[1:]
    for place in range(begin, end):
        plane, y = divmod(place, rows)
        _share_row(result[plane, y], seen, even, plane, y, 0, width)


@compiled
def share_rim(plane, seen, even, number, down: Side, across: Side):
    """Find the rows and columns of a plane that strips are found of, and nothing else.

    Args:
        plane: of a torus; what is written on.
        seen: of all planes.
        even: see there.
        number: of the plane.
        down: of the strips.
        across: the same.
    """
    height, width = plane.shape
    thick, wide = down.matrix.shape[-1], across.matrix.shape[-1]
    right = min(across.start + wide, width)  # what is beyond lies on the left
    left = across.start + wide - right
    for y in range(height):
        if (y - down.start) % height < thick:
            _share_row(plane[y], seen, even, number, y, 0, width)
        else:
            _share_row(plane[y], seen, even, number, y, 0, left)
            _share_row(plane[y], seen, even, number, y, across.start, right)


@compiled
def _share_row(row, seen, even, plane, y, left, right):
    """Pixels from and to."""
    (number, height, width), channels = even.shares.shape, even.rest.shape[1]
    inside = max(left, min(right, width)) if y < height else left
    if left < inside:
        rest = even.rest[plane // (channels * number), plane % channels]
        share = even.shares[plane // channels % number, y, left:inside]
        _set(row[left:inside], seen[plane, y, left:inside], share, rest)
    row[inside:right] = 0


@compiled
def _set(row, seen, share, rest):
    for x in range(len(row)):
        row[x] = seen[x] * share[x] if share[x] > 0 else rest
