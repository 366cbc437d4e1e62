"""Planes that are transformed while they are in the cache: behind or before they are added up."""

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from layerfield.kernels.blends import Blend, blend_row, planes_of
from layerfield.kernels.compiled import compiled
from layerfield.kernels.transforms import call_of, plane_transform, transform_, transform_one


def transformed(
    planes: Float[Tensor, "*batch ty tx"] | Blend, by_row: bool
) -> Complex[Tensor, "*batch ty half"]:
    """Return the transform of planes, neighbours along x taken for one complex pixel.

    Args:
        planes: may be written on.
        by_row: every row by itself, or both directions.
    """
    if isinstance(planes, Blend):
        *batch, width = planes.shadow.shape
        transform = plane_transform((*batch, width // 2), by_row, back=False)
        if transform is not None:
            result = torch.empty(planes.shadow.shape, dtype=torch.float32)
            made, known = planes_of(result), planes.sum()
            forth.in_spans(made, known, call_of(transform), count=len(made), numbers=made.size)
            return _pairs(result)
        planes = planes.planes()
    values = _pairs(planes.detach().contiguous())
    transform_(values, by_row=by_row)
    return values


def transformed_back(
    values: Complex[Tensor, "*batch ty half"], by_row: bool, added: Blend | None
) -> Float[Tensor, "*batch ty tx"]:
    """Return the planes of a transform, which is written on.

    Args:
        values: of it.
        by_row: every row by itself, or both directions.
        added: what is added to them.
    """
    result = torch.view_as_real(values).flatten(-2)
    transform = None if added is None else plane_transform((*values.shape,), by_row, back=True)
    if added is None or transform is None:
        transform_(values, by_row=by_row, back=True)
        return result if added is None else added.planes(onto=result)
    made = planes_of(result)
    back.in_spans(made, added.sum(), call_of(transform), count=len(made), numbers=made.size)
    return result


def _pairs(planes: Tensor) -> Tensor:
    return torch.view_as_complex(planes.unflatten(-1, (-1, 2)))


@compiled
def forth(planes, known, call, begin, end):
    """Planes from and to."""
    for plane in range(begin, end):
        for y in range(planes.shape[1]):
            blend_row(planes[plane, y], known, plane, y, True)
        transform_one(planes[plane], call)


@compiled
def back(planes, known, call, begin, end):
    """Planes from and to."""
    for plane in range(begin, end):
        transform_one(planes[plane], call)
        for y in range(planes.shape[1]):
            blend_row(planes[plane, y], known, plane, y, False)
