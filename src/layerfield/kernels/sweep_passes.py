"""What a sweep is made of but the normal equations: a pass for every layer, and two behind all."""

import math
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from layerfield.kernels.compiled import compiled, serve
from layerfield.kernels.gpu.serving import on_gpu
from layerfield.kernels.light_paths import LightPaths
from layerfield.links import Multiplicative

Layers = Float[Tensor, "*batch 1 layer c ly lx"]
Subframes = Float[Tensor, "*batch subframe layer c ly lx"]
One = Float[Tensor, "*batch 1 1 c ly lx"]

_ALL = (-5, -4, -3, -2, -1)  # directions of the layers of a light field
_ZERO = np.float32(0)
_LEAST = np.float32(1e-12)  # curvature: one over less than that may be infinite


class _Bounds(NamedTuple):
    low: np.float32
    high: np.float32


def move_layer_(
    layers: Layers, index: int, slope: One, curvature: One, bounds: tuple[float, float]
) -> None:
    """Move one layer to clamp(P + slope / curvature), in place.

    Pixels without curvature influence nothing, and stay.

    Args:
        layers: P; contiguous, of single precision, on a processor, as all others.
        index: of the layer.
        slope: what to go against, per pixel.
        curvature: of the error.
        bounds: of pixels.
    """
    planes, *given = (_by_layer(each) for each in (layers, slope, curvature))
    known = _bounds(bounds)
    rows, numbers = math.prod(given[0].shape[:-1]), 3 * slope.numel()
    _move_rows.in_spans(planes, index, *given, known, count=rows, numbers=numbers)


def leads_uphill(
    ahead: Subframes, layers: Subframes, last: Subframes
) -> Bool[Tensor, "*batch 1 1 1 1 1"]:
    """Return whether a sweep went back: whether (A - P) (P - P of one sweep ago) is above 0.

    Args:
        ahead: A, where the sweep, or a step of gradients, began.
        layers: P, where it ended.
        last: where the one before it ended.
    """
    given = ahead, layers, last
    if not (serve(*given) and all(each.is_contiguous() for each in given)):
        return ((ahead - layers) * (layers - last)).sum(dim=_ALL, keepdim=True) > 0
    seen = [_by_row(each) for each in given]
    sums = np.empty(seen[0].shape[:2])
    _multiply_rows.in_spans(sums, *seen, count=sums.size, numbers=3 * layers.numel())
    found = torch.from_numpy(sums.sum(axis=1) > 0)
    return found.view(*layers.shape[:-5], 1, 1, 1, 1, 1)


def ahead(
    layers: Subframes,
    last: Subframes,
    push: Float[Tensor, "*batch 1 1 1 1 1"],
    bounds: tuple[float, float],
) -> Subframes:
    """Return clamp(P + push (P - P of one sweep ago)).

    Args:
        layers: P.
        last: where the sweep before ended.
        push: share of the change.
        bounds: of pixels.
    """
    if not (serve(layers, last) and layers.is_contiguous() and last.is_contiguous()):
        return (layers - last).mul_(push).add_(layers).clamp_(*bounds)
    result = torch.empty_like(layers)
    made, *seen = (_by_row(each) for each in (result, layers, last))
    given = made, *seen, push.flatten().numpy(), _bounds(bounds)
    _extrapolate_rows.in_spans(*given, count=math.prod(made.shape[:2]), numbers=3 * layers.numel())
    return result


def serve_colours(paths: LightPaths, layers: Subframes, bounds: tuple[float, float]) -> bool:
    """Whether `swept_colours` serves: on a GPU, 8-bit views of three colours, a product."""
    product = isinstance(paths.link, Multiplicative)
    if not (product and paths.serve(layers) and on_gpu(layers)):
        return False
    from layerfield.kernels.gpu.colour_sweeps import serves  # noqa: PLC0415  needs Triton

    return serves(paths, bounds)


def swept_colours(
    paths: LightPaths, layers: Layers, last: Layers, push: Float[Tensor, "*batch 1 1 1 1 1"]
) -> tuple[Layers, Bool[Tensor, "*batch 1 1 1 1 1"]]:
    """Return the layers after a whole sweep, and what `leads_uphill` does; see `serve_colours`.

    Args:
        paths: from the layers to the views.
        layers: P.
        last: where the sweep before ended.
        push: as of `ahead`, where this one begins.
    """
    from layerfield.kernels.gpu.colour_sweeps import swept  # noqa: PLC0415  needs Triton

    for each in (layers, last):
        paths.expect(each, layers.shape[-4])
    moved, uphill = swept(paths, layers, last, push)
    return moved, uphill.view(push.shape)


def _by_layer(layers: Tensor) -> np.ndarray:
    """Return `[n, layer, c, y, x]`."""
    return layers.detach().view(-1, *layers.shape[-4:]).numpy()


def _by_row(layers: Tensor) -> np.ndarray:
    """Return `[n, row of any layer and channel, x]`."""
    return layers.detach().view(math.prod(layers.shape[:-5]), -1, layers.shape[-1]).numpy()


def _bounds(bounds: tuple[float, float]) -> _Bounds:
    return _Bounds(*map(np.float32, bounds))


@compiled
def _move_rows(layers, index, slopes, curvatures, bounds, begin, end):
    """Rows of a layer in all its channels, one after the other, from and to."""
    channels, height = layers.shape[2:4]
    for number in range(begin, end):
        item, place = divmod(number, channels * height)
        channel, y = divmod(place, height)
        row = layers[item, index, channel, y]
        _move(row, slopes[item, 0, channel, y], curvatures[item, 0, channel, y], bounds)


@compiled
def _move(row, slope, curvature, bounds):
    for x in range(len(row)):
        bent = curvature[x]
        step = slope[x] / max(bent, _LEAST) if bent > _ZERO else _ZERO
        row[x] = min(max(row[x] + step, bounds.low), bounds.high)


@compiled
def _multiply_rows(sums, ahead, layers, last, begin, end):
    """Rows of all layers, one after the other, from and to."""
    for number in range(begin, end):
        item, row = divmod(number, sums.shape[1])
        sums[item, row] = _product(ahead[item, row], layers[item, row], last[item, row])


@compiled
def _product(ahead, row, last):
    total = _ZERO
    for x in range(len(row)):
        total += (ahead[x] - row[x]) * (row[x] - last[x])
    return total


@compiled
def _extrapolate_rows(result, layers, last, push, bounds, begin, end):
    """Rows of all layers, one after the other, from and to."""
    for number in range(begin, end):
        item, row = divmod(number, layers.shape[1])
        extrapolate(result[item, row], layers[item, row], last[item, row], push[item], bounds)


@compiled
def extrapolate(made, row, last, push, bounds):
    """Write where a sweep begins into a row; see `ahead`."""
    for x in range(len(row)):
        moved = row[x] + push * (row[x] - last[x])
        made[x] = min(max(moved, bounds.low), bounds.high)
