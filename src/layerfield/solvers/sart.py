"""The simultaneous algebraic reconstruction technique, the classical additive solver."""

import math
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from layerfield.problem import Problem


@dataclass(frozen=True)
class Sart:
    """Correct the layers view by view; one iteration passes over all views.

        P_k <- clamp(P_k + a w_i A_ik^T (L_i - A_i P) / K)

    K, the number of layers, is the row sum of A_i; columns of one view sum to one. Views follow
    each other in an order that keeps successive ones far apart.

    Args:
        relaxation: a.

    Reference: Andersen and Kak, Ultrasonic Imaging 6, 1984; for layered displays Wetzstein et
    al., ACM TOG 30(4), 2011.
    """

    relaxation: float = 0.3

    def init(self, problem: Problem, start: Tensor | None) -> Tensor:
        return problem.flat_start() if start is None else start.clone()

    def step(self, problem: Problem, state: Tensor) -> Tensor:
        layers = state.clone()
        largest = max(problem.weights)
        for i in _scattered(len(problem.weights)):
            step = self.relaxation * problem.weights[i] / largest / problem.layer_count
            residual = (problem.light(i) - problem.view(layers, i)).mul_(step)
            for k in range(problem.layer_count):
                layer = layers[..., k, :, :, :]
                problem.projection.scatter_(layer, residual.unsqueeze(-4), i, k)
            layers.clamp_(*problem.bounds)
        return layers

    def layers(self, problem: Problem, state: Tensor) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        return state


def _scattered(count: int) -> list[int]:
    """Visit 0 .. count - 1 in strides near the golden section, which keeps neighbours apart."""
    stride = max(1, round(count * (math.sqrt(5) - 1) / 2))
    while math.gcd(stride, count) != 1:
        stride += 1
    return [i * stride % count for i in range(count)]
