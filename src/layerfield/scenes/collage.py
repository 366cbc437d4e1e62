"""Dead leaves: opaque shapes of all sizes that hide one another, as things in photographs do."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.scenes.draws import Draws

_ORDER = (9, 6, 8, 3, 7, 5, 1, 4, 8, 2, 6, 0, 3)  # rank of the leaf size, painted back to front
_SMALLEST = 4.0  # cell of the smallest leaves, in pixels
_NUMBERS = 9
_AT_ONCE = 2**19  # texels, few enough to stay in the processor's cache


def collage(
    draws: Draws, count: int, chosen: Tensor, *, canvas: tuple[int, int], texels: int
) -> tuple[Float[Tensor, "n ty tx"], Float[Tensor, "n ty tx"]]:
    """Return tone (about -1..1) and colour mix (0..1) of a collage for each chosen surface.

    Each sheet of leaves is a lattice of cells with at most one leaf in a cell, random in place,
    size, shape and presence, so that a sheet costs the same however many leaves it has.

    Args:
        draws: where the numbers come from.
        count: surfaces of a scene.
        chosen: indices into the flattened `[batch, surface]` of those that get a collage.
        canvas: height and width in pixels.
        texels: samples per pixel.
    """
    height, width = (n * texels for n in canvas)
    largest = 0.8 * min(canvas)
    finest = draws.log_uniform(count, low=_SMALLEST, high=0.3 * largest).flatten()[chosen]
    tone = draws.normal(count).flatten()[chosen, None, None].expand(-1, height, width).contiguous()
    mix = torch.zeros_like(tone)
    tone *= 0.3
    some = max(1, _AT_ONCE // (height * width))
    for rank in _ORDER:
        cell = largest * (_SMALLEST / largest) ** (1 - rank / max(_ORDER))
        side = max(3, round(cell * texels))
        rows, columns = -(-height // side) + 1, -(-width // side) + 1
        numbers = draws.uniform(count, _NUMBERS, rows, columns).flatten(0, 1)[chosen]
        present = 0.7 * (cell >= finest)
        sheets = (field.split(some) for field in (tone, mix, numbers, present))
        for part in zip(*sheets, strict=True):
            _paint(*part, side=side, texels=texels)
    return tone, mix


def _paint(
    tone: Tensor, mix: Tensor, numbers: Tensor, present: Tensor, *, side: int, texels: int
) -> None:
    """Paint one sheet of leaves over tone and mix, in place."""
    height, width = tone.shape[-2:]
    rows = numbers.shape[-2]
    top, left = (side * 5) // 13, (side * 4) // 7  # lattices of different sheets do not line up
    column = torch.arange(left, left + width, device=tone.device)
    row = torch.arange(side, device=tone.device)
    # [n, rows, 1, width]: parameters follow the columns, rows within a cell are broadcast
    spread = numbers[..., column // side][..., None, :].unbind(1)
    size, jitter_x, jitter_y, turn, aspect, box, there, shade, blend = spread
    radius = side * (0.3 + 0.2 * size)
    slack = side / 2 - radius
    x = (column % side - (side - 1) / 2) - (2 * jitter_x - 1) * slack
    y0 = (2 * jitter_y - 1) * slack
    cos, sin = torch.cos(2 * math.pi * turn), torch.sin(2 * math.pi * turn)
    long, short = 1 / radius, 1 / (radius * (0.35 + 0.65 * aspect))
    y = (row - (side - 1) / 2)[:, None].to(tone.dtype)
    px = torch.addcmul((cos * x - sin * y0) * long, sin * long, y)
    py = torch.addcmul((-sin * x - cos * y0) * short, cos * short, y)
    level = _norm(px, py, box < 0.35)
    exists = (there < present[:, None, None, None]).to(tone.dtype)
    sharp = exists / (short * texels)  # distance in pixels per unit of level
    alpha = torch.addcmul(0.5 * exists + sharp, sharp, level, value=-1).clamp_(0, 1)
    ramp = 0.5 * (2 * size - 1)
    leaf = torch.addcmul(2.4 * shade - 1.2, ramp, px)

    def whole(cells: Tensor) -> Tensor:
        return cells.reshape(-1, rows * side, width)[:, top : top + height]

    tone.lerp_(whole(leaf), whole(alpha))
    mix.lerp_(whole(blend.expand_as(alpha)), whole(alpha))


def _norm(x: Tensor, y: Tensor, boxy: Tensor) -> Tensor:
    """Distance from the centre: Euclidean for ovals, largest coordinate for boxes."""
    oval = (x * x).addcmul_(y, y).sqrt_()
    return torch.where(boxy, torch.maximum(x.abs(), y.abs()).mul_(1.41), oval)
