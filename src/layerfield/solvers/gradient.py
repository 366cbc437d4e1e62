"""Accelerated projected gradients: any link, the classical first-order method."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.composition import compose_views
from layerfield.kernels import grid_sweeps, sweep_passes
from layerfield.kernels.compiled import serve
from layerfield.problem import Problem
from layerfield.solvers.slope import slope


@dataclass(frozen=True, eq=False)
class GradientState:
    """Layers, the extrapolated point, and the momentum counter t of every light field."""

    layers: Float[Tensor, "*batch subframe layer c ly lx"]
    ahead: Float[Tensor, "*batch subframe layer c ly lx"]
    momentum: Float[Tensor, "*batch 1 1 1 1 1"]


@dataclass(frozen=True)
class Gradient:
    """Accelerated projected gradients with adaptive restart.

        P' = clamp(Y - grad f(Y) / C),  C_k = K o^2 A_k^T W 1,  Y' = P' + (t - 1) / t' (P' - P)

    o is the largest derivative of the link. C bounds the curvature of a sum, pixel by pixel (the
    weight of all views, or of fewer near the border), and that of other links up to the residual.
    A subframe shows a share of the light, so steps grow by it. Pixels that nobody sees stay.

    Where light adds up and views stand in a grid, grad f is G Y - A^T L, with nothing of the views
    but A^T L; elsewhere it is summed up along the light paths, and that of several subframes found
    by differentiating the display automatically.

    Reference: Beck and Teboulle, SIAM J. Imaging Sciences 2(1), 2009; restart: O'Donoghue and
    Candes, Found. Comput. Math. 15, 2015.
    """

    def init(self, problem: Problem, start: GradientState | Tensor | None) -> GradientState:
        if isinstance(start, GradientState):
            return start
        layers = problem.flat_start() if start is None else start.clone()
        return GradientState(layers, layers, layers.new_ones(*layers.shape[:-5], 1, 1, 1, 1, 1))

    def step(self, problem: Problem, state: GradientState) -> GradientState:
        layers, uphill = _descended(problem, state.ahead, state.layers)
        following = (1 + (1 + 4 * state.momentum**2).sqrt()) / 2
        push = torch.where(uphill, 0, (state.momentum - 1) / following)
        ahead = state.layers.lerp(layers, 1 + push)
        return GradientState(layers, ahead, torch.where(uphill, 1, following))

    def layers(
        self, problem: Problem, state: GradientState
    ) -> Float[Tensor, "*batch subframe layer c ly lx"]:
        return state.layers


def _descended(problem: Problem, ahead: Tensor, last: Tensor) -> tuple[Tensor, Tensor]:
    """Return P' = clamp(Y - grad f(Y) / C), and whether to begin anew: (Y - P') (P' - P) above 0.

    Args:
        problem: f and its bounds.
        ahead: Y.
        last: P.
    """
    if (grid := problem.grid(at_once=True)) is not None:
        seen, ahead, last = (x.contiguous() for x in (problem.back_projected, ahead, last))
        if serve(seen, ahead, last):
            return grid_sweeps.moved(grid, seen, ahead, last, problem.bounds)
        every = range(problem.layer_count)
        moved = torch.stack([grid.settled(ahead, seen, k) for k in every], dim=-4)
    else:
        share = problem.subframes / problem.link.steepest**2
        step = problem.constants.even_shares  # 1 / (K A_k^T W 1)
        moved = torch.addcmul(ahead, _gradient(problem, ahead), step, value=-share)
    layers = moved.clamp_(*problem.bounds)
    return layers, sweep_passes.leads_uphill(ahead, layers, last)


def _gradient(problem: Problem, layers: Tensor) -> Tensor:
    """Return grad f, of f = 1/2 sum_i w_i ||link(A_i P) - L_i||^2."""
    if problem.subframes == 1:
        return slope(problem, layers)
    with torch.inference_mode(False), torch.enable_grad():
        variable = layers.detach().clone().requires_grad_()  # a copy has no inference mode
        views = compose_views(variable, problem.projection, problem.link)
        residual = views - problem.target
        weights = residual.new_tensor(problem.weights)[:, None, None, None]
        loss = 0.5 * (weights * residual.square()).sum()
        return torch.autograd.grad(loss, variable)[0]
