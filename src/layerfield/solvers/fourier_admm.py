"""The direct solver: ADMM whose linear system is a small matrix per frequency."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.blends import Blend, Shares
from layerfield.solve import Problem


@dataclass(frozen=True, eq=False)
class AdmmState:
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
        # s + a (x - z)
        rest = Blend(Shares(-self.relaxation, 1), state.shadow, problem.bounds)
        return AdmmState(self._solved(problem, state, self.relaxation, rest), state.penalty)

    def unbounded(
        self, problem: Problem, state: AdmmState
    ) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        """Return x of the next iteration, before the box: it holds the best dual certificate."""
        return problem.gram.from_torus(self._solved(problem, state))

    def _solved(
        self, problem: Problem, state: AdmmState, gain: float = 1.0, added: Blend | None = None
    ) -> Tensor:
        rho = sum(problem.weights) * state.penalty
        # z - u + b / rho, z - u = 2 z - s
        right = right_hand_side(problem, state.shadow, Shares(2, -1, 1 / rho))
        spectral = problem.gram.spectral
        return spectral.solved_pixels(right, state.penalty, self.balance, gain, added=added)

    def layers(self, problem: Problem, state: AdmmState) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        return problem.gram.from_torus(state.shadow).clamp(*problem.bounds)


def right_hand_side(
    problem: Problem, shadow: Float[Tensor, "*batch 1 layer c ty tx"], shares: Shares
) -> Float[Tensor, "*batch 1 layer c ty tx"] | Blend:
    """Return shares of z, s and b: A^T W L, and around the views what layers show there."""
    gram, bounds = problem.gram, problem.bounds
    right = Blend(shares, shadow, bounds, problem.back_projected)
    if right.serves() and (strips := gram.strips(shadow, bounds)) is not None:
        return replace(right, strips=strips)
    planes = right.planes()
    gram.add_band_(planes, shadow, shares.other, bounds)
    return planes


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
