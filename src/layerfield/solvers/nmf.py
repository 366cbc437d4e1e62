"""Multiplicative updates of non-negative least squares, for additive displays."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.problem import Problem


@dataclass(frozen=True)
class Nmf:
    """P <- min(1, P * (A^T W L) / (A^T W A P)), from constant layers.

    The views are read once, and A^T W A is applied in the Fourier domain, so that an iteration
    costs about as much as one of the direct solver.

    Reference: Lee and Seung, "Algorithms for non-negative matrix factorization", NIPS 2000,
    equation (4), with one factor fixed.
    """

    def init(self, problem: Problem, start: Tensor | None) -> Tensor:
        return problem.flat_start() if start is None else start.clamp(*problem.bounds)

    def step(self, problem: Problem, state: Tensor) -> Tensor:
        gram = problem.gram
        shown = gram.from_torus(gram(gram.to_torus(state)))
        ratio = problem.back_projected / shown.clamp(min=1e-6 * sum(problem.weights))
        return torch.where(problem.coverage > 0, ratio, 1).mul_(state).clamp_(*problem.bounds)

    def layers(self, problem: Problem, state: Tensor) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        return state
