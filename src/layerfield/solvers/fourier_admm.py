"""The direct solver: ADMM whose linear system is a small matrix per frequency."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.gram import interleaved, inverse, multiply
from layerfield.solve import Problem


@dataclass(frozen=True, eq=False)
class AdmmState:
    """Iterate and dual in one: z = clamp(shadow), u = shadow - z, on the torus.

    Args:
        shadow: s = z + u.
        resolvent: 2 rho (G + rho I)^-1, as `multiply` wants it.
    """

    shadow: Float[Tensor, "*batch 1 layer c ty tx"]
    resolvent: Tensor


@dataclass(frozen=True)
class FourierAdmm:
    """Minimise 1/2 ||A P - L||^2_W over a box, for links that are a sum.

        x = (G + rho I)^-1 (A^T W L + rho (z - u)),  x <- a x + (1 - a) z
        z = clamp(x + u),  u <- u + x - z

    written with the one array s = z + u. Views are cropped: A^T W L is completed by what the
    current layers show around the views (majorise-minimise; the fixed point is the exact cropped
    optimum). At low frequencies the solution is not unique, and since start and steps divide
    light evenly among layers, the balanced one is found.

    Args:
        penalty: rho as a share of the sum of view weights.
        relaxation: a, 1 to 2.
    """

    penalty: float = 0.05
    relaxation: float = 1.6

    def init(self, problem: Problem, start: AdmmState | Tensor | None) -> AdmmState:
        if isinstance(start, AdmmState):
            return start
        gram = problem.gram
        symbol = gram.symbol
        rho = self._rho(problem)
        identity = torch.eye(len(symbol), dtype=symbol.dtype, device=symbol.device)
        resolvent = 2 * rho * inverse(symbol + rho * identity[:, :, None, None])
        layers = problem.even_start() if start is None else start
        return AdmmState(gram.to_torus(layers), interleaved(resolvent))

    def step(self, problem: Problem, state: AdmmState) -> AdmmState:
        gram, share = problem.gram, 1 / (2 * self._rho(problem))
        iterate = state.shadow.clamp(*problem.bounds)
        # A^T W L + rho (z - u) + band, all over 2 rho; z - u = 2 z - s
        right = torch.sub(iterate, state.shadow, alpha=0.5)
        gram.from_torus(right).add_(problem.back_projected, alpha=share)
        gram.add_band_(right, iterate, share)
        spectrum = multiply(state.resolvent, torch.fft.rfft2(right))
        solved = torch.fft.irfft2(spectrum, s=gram.torus).sub_(iterate)
        shadow = torch.add(state.shadow, solved, alpha=self.relaxation, out=solved)
        return AdmmState(shadow, state.resolvent)

    def layers(self, problem: Problem, state: AdmmState) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        return problem.gram.from_torus(state.shadow).clamp(*problem.bounds)

    def _rho(self, problem: Problem) -> float:
        return self.penalty * sum(problem.weights)
