"""The direct solver: ADMM whose linear system is a small matrix per frequency."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.problem import Problem
from layerfield.solve import OutlivesViews
from layerfield.solvers.admm_steps import (
    after_steps,
    plain_constants,
    right_hand_side,
    right_shares,
)


@dataclass(frozen=True, eq=False)
class AdmmState(OutlivesViews):
    """Iterate and dual in one: z = clamp(shadow), u = shadow - z, on the torus.

    Args:
        shadow: s = z + u.
        penalty: rho as a share of the sum of view weights.
    """

    shadow: Float[Tensor, "*batch 1 layer c ty tx"]
    penalty: float


@dataclass(frozen=True)
class FourierAdmm:
    """Minimise 1/2 ||A P - L||^2_W over a box, for links that are a sum.

        x = (G + rho I)^-1 (A^T W L + rho (z - u)),  x <- a x + (1 - a) z
        z = clamp(x + u),  u <- u + x - z

    written with the one array s = z + u. Views are cropped: A^T W L is completed by what the
    current layers show around the views (majorise-minimise; the fixed point is the exact cropped
    optimum). At low frequencies light can be moved from layer to layer at hardly any cost: the
    start shares it evenly, and the means are held together by a small quadratic term.

    Args:
        penalty: rho as a share of the sum of view weights.
        warm_penalty: the same when given layers are the start. They are near the optimum, the
            more so the lower the frequency: what is left to do is better done stiffly, and the
            dual, which the gradient over rho says at bounds, is less disturbed by their errors.
        relaxation: a, 1 to 2.
        balance: of the term b/2 sum_k (mean P_k - mean P)^2 per pixel, as a share of the sum of
            view weights; 0 for the optimum, whatever its split.
    """

    penalty: float = 0.05
    warm_penalty: float = 0.2
    relaxation: float = 1.6
    balance: float = 0.003

    def init(self, problem: Problem, start: AdmmState | Tensor | None) -> AdmmState:
        if isinstance(start, AdmmState):
            return start
        if start is None:
            return AdmmState(problem.even_start(problem.gram.torus), self.penalty)
        shadow = problem.gram.to_torus(start)
        dual = _dual(problem, shadow, sum(problem.weights) * self.warm_penalty)
        return AdmmState(shadow + dual, self.warm_penalty)

    def step(self, problem: Problem, state: AdmmState) -> AdmmState:
        return self.steps(problem, state, 1)

    def steps(self, problem: Problem, state: AdmmState, count: int) -> AdmmState:
        constants = [plain_constants(state.penalty, self.relaxation)] * count
        shadow, _ = after_steps(problem, state.shadow, None, constants, self.balance)
        return AdmmState(shadow, state.penalty)

    def unbounded(
        self, problem: Problem, state: AdmmState
    ) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        """Return x of the next iteration, before the box: it holds the best dual certificate."""
        spectral, constants = problem.gram.spectral, plain_constants(state.penalty)
        right = right_hand_side(problem, state.shadow, right_shares(spectral, constants))
        return problem.gram.from_torus(spectral.solved_pixels(right, state.penalty, self.balance))

    def layers(self, problem: Problem, state: AdmmState) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        return problem.gram.clamped_from_torus(state.shadow, problem.bounds)


def _dual(problem: Problem, iterate: Tensor, rho: float) -> Tensor:
    gradient = problem.gram(iterate)
    problem.gram.from_torus(gradient).sub_(problem.back_projected)
    return dual_at_bounds(iterate, gradient, problem.bounds, rho)


def dual_at_bounds(
    iterate: Float[Tensor, "*batch layer c y x"],
    gradient: Float[Tensor, "*batch layer c y x"],
    bounds: tuple[float, float],
    rho: float | Tensor,
) -> Float[Tensor, "*batch layer c y x"]:
    """Return the dual of nearly optimal layers: u = -gradient / rho where a bound holds."""
    low, high = bounds
    held = ((iterate <= low) & (gradient > 0)) | ((iterate >= high) & (gradient < 0))
    return torch.where(held, gradient / -rho, 0)
