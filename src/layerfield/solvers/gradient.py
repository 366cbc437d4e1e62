"""Projected gradients through the differentiable display: any link, the slow reference."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.composition import compose_views
from layerfield.problem import Problem

_ALL = (-5, -4, -3, -2, -1)  # directions of the layers of a light field


@dataclass(frozen=True, eq=False)
class GradientState:
    """Layers, the extrapolated point, and the momentum counter t of every light field."""

    layers: Float[Tensor, "*batch subframe layer c ly lx"]
    ahead: Float[Tensor, "*batch subframe layer c ly lx"]
    momentum: Float[Tensor, "*batch 1 1 1 1 1"]


@dataclass(frozen=True)
class Gradient:
    """Accelerated projected gradients with adaptive restart, differentiated automatically.

        P' = clamp(Y - grad f(Y) / (K o^2 sum w)),  Y' = P' + (t - 1) / t' (P' - P)

    o is the largest derivative of the link: K o^2 sum w bounds the curvature of a sum, and that
    of other links up to the residual. A subframe shows a share of the light, so steps grow by it.

    Reference: Beck and Teboulle, SIAM J. Imaging Sciences 2(1), 2009; restart: O'Donoghue and
    Candes, Found. Comput. Math. 15, 2015.
    """

    def init(self, problem: Problem, start: GradientState | Tensor | None) -> GradientState:
        if isinstance(start, GradientState):
            return start
        layers = problem.flat_start() if start is None else start.clone()
        return GradientState(layers, layers, layers.new_ones(*layers.shape[:-5], 1, 1, 1, 1, 1))

    def step(self, problem: Problem, state: GradientState) -> GradientState:
        gradient = _gradient(problem, state.ahead)
        curvature = problem.layer_count * sum(problem.weights) * problem.link.steepest**2
        curvature /= problem.subframes
        layers = (state.ahead - gradient / curvature).clamp(*problem.bounds)
        moved = layers - state.layers
        uphill = ((state.ahead - layers) * moved).sum(dim=_ALL, keepdim=True) > 0  # begin anew
        following = (1 + (1 + 4 * state.momentum**2).sqrt()) / 2
        push = torch.where(uphill, 0, (state.momentum - 1) / following)
        return GradientState(layers, layers + moved * push, torch.where(uphill, 1, following))

    def layers(
        self, problem: Problem, state: GradientState
    ) -> Float[Tensor, "*batch subframe layer c ly lx"]:
        return state.layers


def _gradient(problem: Problem, layers: Tensor) -> Tensor:
    """The gradient of 1/2 sum_i w_i ||L_i - target_i||^2 by automatic differentiation."""
    with torch.inference_mode(False), torch.enable_grad():
        variable = layers.detach().clone().requires_grad_()  # a copy has no inference mode
        views = compose_views(variable, problem.projection, problem.link)
        residual = views - problem.target
        weights = residual.new_tensor(problem.weights)[:, None, None, None]
        loss = 0.5 * (weights * residual.square()).sum()
        return torch.autograd.grad(loss, variable)[0]
