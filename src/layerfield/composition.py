"""The views that layers compose under a link, differentiable with a derivative written out.

L_i(x) = mean over subframes of link_k P_k(x + d_ik)
"""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from layerfield.links import Link
from layerfield.projection import Projection


def compose_view(
    layers: Float[Tensor, "*batch subframe layer c ly lx"],
    projection: Projection,
    link: Link,
    view: int,
) -> Float[Tensor, "*batch c y x"]:
    """Return one view, unclipped."""
    return link.compose(projection.windows(layers, view)).mean(dim=-4)


def compose_views(
    layers: Float[Tensor, "*batch subframe layer c ly lx"], projection: Projection, link: Link
) -> Float[Tensor, "*batch view c y x"]:
    """Return all views, unclipped; once differentiable by the layers."""
    return _Views.apply(layers, projection, link)  # pyright: ignore[reportReturnType]


class _Views(torch.autograd.Function):
    """What layers show, view by view, with its derivative written out.

    Automatic differentiation of the same loop would fill a zero picture for every view and layer.
    """

    @staticmethod
    def forward(ctx: Any, layers: Tensor, projection: Projection, link: Link) -> Tensor:
        ctx.save_for_backward(layers)
        ctx.geometry = projection, link
        views = [compose_view(layers, projection, link, i) for i in range(len(projection.shifts))]
        return torch.stack(views, dim=-4)

    @staticmethod
    @once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, *gradients: Tensor
    ) -> tuple[Tensor, None, None]:
        (layers,) = ctx.saved_tensors
        projection, link = ctx.geometry
        share = gradients[0].unsqueeze(-5) / layers.shape[-5]
        result = torch.zeros_like(layers)
        for i in range(len(projection.shifts)):
            pixels = projection.windows(layers, i)
            for k in range(len(pixels)):
                slope = share[..., i, :, :, :] * link.derivative(pixels, k)
                projection.scatter_(result[..., k, :, :, :], slope, i, k)
        return result, None, None
