"""Muon: momentum whose steps are made orthogonal, for convolution kernels."""

from collections.abc import Iterable

import torch
from jaxtyping import Float
from torch import Tensor

_A, _B, _C = 3.4445, -4.7750, 2.0315  # steepest at 0 among quintics that stay near 1


class Muon(torch.optim.Optimizer):
    """Steps along the momentum, every direction in it alike.

    W <- W - rate * sqrt(max(1, out / in)) * orthogonal(gradient + momentum * M)

    A kernel counts as a matrix, output channels times all it sees.

    Args:
        parameters: kernels, two or more dimensions.
        lr: rate.
        momentum: M <- momentum * M + gradient.

    Reference:
        Jordan et al. 2024, "Muon: an optimizer for hidden layers in neural networks".
    """

    def __init__(
        self, parameters: Iterable[Tensor], lr: float = 0.01, momentum: float = 0.95
    ) -> None:
        super().__init__(parameters, {"lr": lr, "momentum": momentum})

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        for group in self.param_groups:
            for weight in group["params"]:
                if weight.grad is None:
                    continue
                state = self.state[weight]
                if not state:
                    state["momentum"] = torch.zeros_like(weight)
                mean = state["momentum"].mul_(group["momentum"]).add_(weight.grad)
                ahead = torch.add(weight.grad, mean, alpha=group["momentum"]).flatten(1)
                tall = max(1.0, ahead.shape[0] / ahead.shape[1]) ** 0.5
                update = orthogonal(ahead).view_as(weight)
                weight.add_(update, alpha=-group["lr"] * tall)


def orthogonal(matrix: Float[Tensor, "rows columns"]) -> Float[Tensor, "rows columns"]:
    """Return about U V^T of the singular value decomposition U S V^T.

    Five quintic Newton-Schulz steps bring every singular value between 0.7 and 1.2, which half
    precision is good enough for.
    """
    if matrix.shape[0] > matrix.shape[1]:
        return orthogonal(matrix.T).T
    x = (matrix / (matrix.norm() + 1e-7)).bfloat16()
    for _ in range(5):
        square = x @ x.T
        x = _A * x + (_B * square + _C * square @ square) @ x
    return x.to(matrix.dtype)
