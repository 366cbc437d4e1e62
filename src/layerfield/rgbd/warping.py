"""Views of a picture with depth: rays go from near to far until they meet a surface."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.geometry import Point
from layerfield.rgbd.sheets import Sheet

_FINE = 2  # steps along a ray for each pixel that it passes
_REFINEMENTS = 3
_ROUNDING = 1e-5


def view(front: Sheet, back: Sheet, slope: Point, approach: float = 0.0) -> Float[Tensor, "c y x"]:
    """Return what an eye sees.

    The ray through a pixel x meets what the eye in the middle has at u = x + s d where d(u) = d.
    It comes from the nearest disparity, and passes edges behind the surface that ends there.

    Args:
        front: what the eye in the middle sees.
        back: the same with what is assumed behind it, for rays that pass behind edges.
        slope: of the eye, as in `Geometry.slopes`.
        approach: as in `Geometry.approaches`.
    """
    if (*slope, approach) == (0.0, 0.0, 0.0):
        return front.picture
    start, direction = _rays(front, slope, approach)
    met, farthest = _march(front, start, direction)
    passed = met.isnan()
    behind, farthest = _march(back, start[passed], direction[passed])
    values = _values(front, start, direction, met.nan_to_num())
    values[:, passed] = _values(
        back, start[passed], direction[passed], behind.where(~behind.isnan(), farthest)
    )
    return values.view_as(front.picture)


def _rays(
    sheet: Sheet, slope: Point, approach: float
) -> tuple[Float[Tensor, "ray 2"], Float[Tensor, "ray 2"]]:
    """Return where rays pass the plane of disparity 0, and how far they go for each unit of it."""
    height, width = sheet.disparity.shape
    y, x = (torch.arange(n, dtype=torch.float32) - (n - 1) / 2 for n in (height, width))
    start = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1).flatten(0, 1)
    return start, start.new_tensor(slope) + approach * start


def _march(
    sheet: Sheet, start: Float[Tensor, "ray 2"], direction: Float[Tensor, "ray 2"]
) -> tuple[Float[Tensor, " ray"], Float[Tensor, " ray"]]:
    """Return the disparity of the first surface that rays meet, and the farthest on their way.

    NaN for those that meet none: at an edge they get below a surface without going through it.
    """
    far, near = sheet.disparity.min().item(), sheet.disparity.max().item()
    reach = direction.abs().max().item() if len(direction) else 0.0
    count = math.ceil(_FINE * reach * (near - far)) + 1
    thick = (near - far) / max(count - 1, 1) + sheet.tear
    met = start.new_full((len(start),), math.nan)
    farthest = start.new_full((len(start),), math.inf)
    for level in torch.linspace(near, far, count).tolist():
        found = sheet.nearest(start + direction * level)
        farthest = farthest.minimum(found)
        below = met.isnan() & (found >= level - _ROUNDING) & (found <= level + thick)
        (hit,) = below.nonzero(as_tuple=True)
        there = sheet.nearest(start[hit] + direction[hit] * found[hit, None])
        through = hit[(there - found[hit]).abs() <= sheet.tear]
        met[through] = found[through]
    return met, farthest


def _values(
    sheet: Sheet,
    start: Float[Tensor, "ray 2"],
    direction: Float[Tensor, "ray 2"],
    disparity: Float[Tensor, " ray"],
) -> Float[Tensor, "c ray"]:
    """Return the values where rays meet a surface that is known roughly."""
    for _ in range(_REFINEMENTS):
        _, disparity = sheet.sample(start + direction * disparity[:, None], disparity)
    return sheet.sample(start + direction * disparity[:, None], disparity)[0]
