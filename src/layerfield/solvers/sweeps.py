"""Layer by layer least squares, for any link."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.solve import Problem


@dataclass(frozen=True, eq=False)
class SweepsState:
    """Layers after the last sweep, the extrapolated point, and the sweeps since a restart."""

    layers: Float[Tensor, "*batch subframe layer c ly lx"]
    ahead: Float[Tensor, "*batch subframe layer c ly lx"]
    count: int = 0


@dataclass(frozen=True)
class Sweeps:
    """Sweep over the layers; each step is a least-squares solve of one layer per pixel.

        P_k <- clamp(P_k + A_k^T W o (L - link(P)) / A_k^T W o^2 A_k 1)

    with o the derivative of the link by the layer (for a product, the other layers along the
    path). Exact for whole-pixel shifts and links linear in each layer, descending for fractional
    shifts, where the denominator majorises. Pixels that influence nothing stay. From the third
    sweep on, the start of a sweep is extrapolated along the last change, unless that led uphill.

    Args:
        momentum: the largest extrapolation, as a share of the last change; 0 for plain sweeps.
    """

    momentum: float = 0.9

    def init(self, problem: Problem, start: SweepsState | Tensor | None) -> SweepsState:
        if isinstance(start, SweepsState):
            return start
        layers = problem.flat_start() if start is None else start.clone()
        return SweepsState(layers, layers)

    def step(self, problem: Problem, state: SweepsState) -> SweepsState:
        layers = state.ahead.clone()
        for k in range(problem.layer_count):
            step = layer_step(problem, layers, k)
            layers[..., k, :, :, :].add_(step).clamp_(*problem.bounds)
        moved = layers - state.layers
        uphill = bool(((state.ahead - layers) * moved).sum() > 0)
        count = 1 if uphill else state.count + 1
        push = min(self.momentum, 2 * (count - 1) / (count + 2))
        ahead = layers if push == 0 else moved.mul_(push).add_(layers).clamp_(*problem.bounds)
        return SweepsState(layers, ahead, count)

    def layers(
        self, problem: Problem, state: SweepsState
    ) -> Float[Tensor, "*batch subframe layer c ly lx"]:
        return state.layers


def layer_step(
    problem: Problem, layers: Tensor, index: int
) -> Float[Tensor, "*batch subframe c ly lx"]:
    """Return the change of one layer that minimises the (majorised) error, per pixel."""
    projection, link = problem.projection, problem.link
    gradient = torch.zeros_like(layers[..., index, :, :, :])
    curvature = torch.zeros_like(gradient)
    for i, weight in enumerate(problem.weights):
        pixels = projection.windows(layers, i)
        others = link.derivative(pixels, index)
        residual = problem.target[..., i, :, :, :].unsqueeze(-4) - link.compose(pixels)
        projection.scatter_(gradient, residual.mul_(others), i, index, weight)
        projection.scatter_(curvature, others.square(), i, index, weight)
    return torch.where(curvature > 0, gradient / curvature.clamp(min=1e-12), 0)
