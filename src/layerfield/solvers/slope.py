"""What the error grows by, for any link: the slope that gradients and Newton steps go by."""

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.problem import Problem

_TELLING = 8  # views, at the least, say whether the error has grown
_ALL = (-4, -3, -2, -1)  # directions of a view


def slope(
    problem: Problem,
    layers: Float[Tensor, "*batch 1 layer c ly lx"],
    curvature: Float[Tensor, "*batch 1 layer c ly lx"] | None = None,
    error: Float[Tensor, "*batch 1 1 1 1 1"] | None = None,
) -> Float[Tensor, "*batch 1 layer c ly lx"]:
    """Return g_k = sum_i w_i A_ik^T o_ik (link(P)_i - L_i), what the error grows by.

    Args:
        problem: of any link.
        layers: P.
        curvature: into which sum_i w_i A_ik^T o_ik^2 is written.
        error: to which sum_i w_i ||link(P)_i - L_i||^2 is added, of eight views or a few more: they
            tell whether it grows.
    """
    projection, link, paths = problem.projection, problem.link, problem.light_paths
    result, every = layers.new_empty(layers.shape), _every(problem)
    if paths.serve(layers):
        paths.add_up_(result, layers, second=curvature, error=error, every=every)
        return result
    norms = list[Tensor]()
    for each in (result, curvature):
        if each is not None:
            each.zero_()
    for alone, piece in problem.pieces():
        seen, slopes = piece.of_layers(layers), piece.of_layers(result)
        bent = None if curvature is None else piece.of_layers(curvature)
        for i, weight in enumerate(problem.weights):
            pixels = projection.windows(seen, i)
            residual = link.compose(pixels) - alone.light(i).unsqueeze(-4)
            if error is not None and i % every == 0:
                norm = torch.linalg.vector_norm(residual, dim=_ALL, keepdim=True)
                norms.append(norm * weight**0.5)
            for k in range(problem.layer_count):
                others = link.derivative(pixels, k)
                layer = slopes[..., k, :, :, :]
                projection.scatter_product_(layer, others, residual, i, k, weight)
                if bent is not None:
                    layer = bent[..., k, :, :, :]
                    projection.scatter_product_(layer, others, others, i, k, weight)
    if error is not None:
        error += torch.stack(norms).square().sum(dim=0).unsqueeze(-5)
    return result


def _every(problem: Problem) -> int:
    """Return how many views there are to one whose error is found."""
    return max(1, len(problem.weights) // _TELLING)
