"""Multiplicative updates of tensor displays, for layers that multiply, in any subframes."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.light_paths import Shares
from layerfield.problem import Problem


@dataclass(frozen=True)
class Ntf:
    """P_k <- min(1, P_k * (A_k^T W o L) / (A_k^T W o link(P))), layer after layer.

    o is the product of the other layers along the path. It starts from constant layers.

    Args:
        apart: how much subframes differ at the start, 0 to 1. Less, and the updates, which keep
            what is small small, need many to part them.

    Reference: Wetzstein et al., "Tensor displays", ACM Trans. Graphics 31(4), 2012, section 4.
    """

    apart: float = 0.5

    def init(self, problem: Problem, start: Tensor | None) -> Tensor:
        return problem.flat_start(self.apart) if start is None else start.clamp(*problem.bounds)

    def step(self, problem: Problem, state: Tensor) -> Tensor:
        layers = state.clone()
        for k in range(problem.layer_count):
            layers[..., k, :, :, :].mul_(_ratio(problem, layers, k)).clamp_(*problem.bounds)
        return layers

    def layers(
        self, problem: Problem, state: Tensor
    ) -> Float[Tensor, "*batch subframe layer c ly lx"]:
        return state


def _ratio(
    problem: Problem, layers: Tensor, index: int
) -> Float[Tensor, "*batch subframe c ly lx"]:
    """Return the quotient of what layers should show and what they show, seen from one layer."""
    projection, link = problem.projection, problem.link
    shape, paths = layers[..., index, :, :, :].shape, problem.light_paths
    wanted, found = (layers.new_empty(shape) for _ in range(2))
    if paths.serve(layers):
        paths.add_up_(wanted.unsqueeze(-4), layers, shares=Shares(0, 1), only=index)
        paths.add_up_(found.unsqueeze(-4), layers, shares=Shares(1, 0), only=index)
        return _quotient(wanted, found)
    for each in (wanted, found):
        each.zero_()
    for alone, piece in problem.pieces():
        seen, over, under = (piece.of_layers(each) for each in (layers, wanted, found))
        for i, weight in enumerate(problem.weights):
            pixels = projection.windows(seen, i)
            others = link.derivative(pixels, index)
            shown = link.compose(pixels).mean(dim=-4, keepdim=True)
            target = alone.light(i).unsqueeze(-4)
            projection.scatter_product_(over, others, target, i, index, weight)
            projection.scatter_product_(under, others, shown, i, index, weight)
    return _quotient(wanted, found)


def _quotient(wanted: Tensor, found: Tensor) -> Tensor:
    return torch.where(found > 0, wanted / found.clamp(min=1e-12), 1)
