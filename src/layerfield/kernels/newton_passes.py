"""What a Newton step is made of but slopes and its linear system: a pass before, and one behind.

Layers lie in the top left corner of the torus; see `NewtonAdmm`.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.compiled import compiled, serve
from layerfield.kernels.gpu.serving import on_gpu

Layers = Float[Tensor, "*batch 1 layer c ly lx"]
Torus = Float[Tensor, "*batch 1 layer c ty tx"]


class Before(NamedTuple):
    """Of (D^-1 g + rho trust D u) / rho: rho and trust; bounds; and what D is found with.

    D^2 is the curvature over the weight of all views, or the least share of it.
    """

    rho: float
    trust: float
    low: float
    high: float
    weight: float
    least: float


class Behind(NamedTuple):
    """Shares of the dual and of the last change; and the bounds."""

    kept: float
    momentum: float
    low: float
    high: float


def serve_layers(*values: Tensor | None) -> bool:
    """Whether the passes can be called: as `serve`, and contiguous."""
    if on_gpu(*values):
        return True
    return serve(*values) and all(each is None or each.is_contiguous() for each in values)


def before(
    terms: Before,
    shadow: Layers,
    slope: Layers,
    curvature: Layers | None,
    last: Layers | None,
    torus: tuple[int, int],
) -> tuple[Torus, Layers, Layers]:
    """Return the right-hand side, the dual, which is written into the slope, and D.

    Args:
        terms: of the right-hand side.
        shadow: s.
        slope: g.
        curvature: that D follows from, which is written into it; without one D stays as it was.
        last: D of the step before, whose dual s - z is; without one that follows from g.
        torus: its rows and columns.

    Raises:
        ValueError: there is neither.
    """
    scale, ago = (curvature, last) if curvature is not None else (last, last)
    if scale is None:
        raise ValueError("found neither curvature nor D of the step before")
    right = shadow.new_empty(*shadow.shape[:-2], *torus)
    flags = curvature is not None, ago is None
    if on_gpu(shadow):
        from layerfield.kernels.gpu.newton_passes import before_  # noqa: PLC0415  needs Triton

        before_(right, shadow, slope, scale, scale if ago is None else ago, terms, *flags)
        return right, slope, scale
    seen = [_planes(each) for each in (right, shadow, slope, scale)]
    known = Before._make(map(np.float32, terms))
    before_it = seen[3] if ago is None else _planes(ago)

    count, numbers = seen[0].shape[0] * torus[0], seen[0].size
    _before.in_spans(*seen, before_it, known, *flags, count=count, numbers=numbers)
    return right, slope, scale


def behind(
    terms: Behind,
    shadow: Layers,
    last: Layers | None,
    dual: Layers,
    scale: Layers,
    solved: Torus,
    boldness: Float[Tensor, "*batch 1 1 1 1 1"],
) -> Layers:
    """Return s after the step, which is written into the dual.

    Args:
        terms: how much of what there was before.
        shadow: s.
        last: s of one step ago.
        dual: u.
        scale: D.
        solved: of the linear system.
        boldness: how far to go.
    """
    if on_gpu(shadow):
        from layerfield.kernels.gpu.newton_passes import behind_  # noqa: PLC0415  needs Triton

        behind_(dual, shadow, shadow if last is None else last, scale, solved, boldness, terms)
        return dual
    seen = [_planes(each) for each in (dual, shadow, scale, solved)]
    shares = boldness.expand(*shadow.shape[:-2], 1, 1).flatten().numpy()
    known, ago = Behind._make(map(np.float32, terms)), seen[1] if last is None else _planes(last)

    count, numbers = math.prod(seen[0].shape[:2]), seen[0].size
    _behind.in_spans(*seen, ago, shares, known, count=count, numbers=numbers)
    return dual


def _planes(layers: Tensor) -> np.ndarray:
    return layers.detach().view(-1, *layers.shape[-2:]).numpy()


@compiled
def _before(rights, shadows, slopes, scales, last, terms, is_new, is_first, begin, end):
    """Rows of all planes of the torus, one after the other, from and to."""
    rows, height, width = rights.shape[1], shadows.shape[1], shadows.shape[2]
    for number in range(begin, end):
        plane, y = number // rows, number % rows
        if y >= height:
            rights[plane, y] = 0
            continue
        right, shadow, slope = rights[plane, y], shadows[plane, y], slopes[plane, y]
        right[width:] = 0
        if is_new:
            _find_scale(scales[plane, y], terms)
        if is_first:
            _dual_at_bounds(right, shadow, slope, scales[plane, y], terms)
        else:
            _dual_of(right, shadow, slope, scales[plane, y], last[plane, y], terms)


@compiled
def _find_scale(curvature, terms):
    for x in range(len(curvature)):
        curvature[x] = np.sqrt(max(curvature[x] / terms.weight, terms.least))


@compiled
def _dual_of(right, shadow, slope, scale, last, terms):
    for x in range(len(shadow)):
        iterate = min(max(shadow[x], terms.low), terms.high)
        turned = last[x] / scale[x]
        dual = (shadow[x] - iterate) * turned * turned  # of the same force, rho D^2 u
        right[x] = slope[x] / (terms.rho * scale[x]) + terms.trust * scale[x] * dual
        slope[x] = dual


@compiled
def _dual_at_bounds(right, shadow, slope, scale, terms):
    zero = np.float32(0)
    for x in range(len(shadow)):
        iterate = min(max(shadow[x], terms.low), terms.high)
        held_low = iterate <= terms.low and slope[x] > zero
        held_high = iterate >= terms.high and slope[x] < zero
        force = slope[x] if held_low or held_high else zero
        dual = -force / (terms.rho * scale[x] * scale[x])
        right[x] = slope[x] / (terms.rho * scale[x]) + terms.trust * scale[x] * dual
        slope[x] = dual


@compiled
def _behind(duals, shadows, scales, solved, last, boldness, terms, begin, end):
    """Rows of all planes of the layers, one after the other, from and to."""
    height = duals.shape[1]
    for number in range(begin, end):
        plane, y = number // height, number % height
        dual, shadow, scale = duals[plane, y], shadows[plane, y], scales[plane, y]
        _move(dual, shadow, scale, solved[plane, y], last[plane, y], boldness[plane], terms)


@compiled
def _move(dual, shadow, scale, solved, last, boldness, terms):
    for x in range(len(dual)):
        iterate = min(max(shadow[x], terms.low), terms.high)
        change = solved[x] / scale[x] + terms.momentum * (shadow[x] - last[x])
        dual[x] = boldness * change + iterate + terms.kept * dual[x]
