"""Where things went from one picture to the next: block matching, coarse to fine."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import avg_pool2d, grid_sample, interpolate, pad

_COARSE = 4  # pixels of the fine grid to one of the coarse
_COARSE_BLOCK, _FINE_BLOCK = 4, 8  # pixels of their own grid
_COARSE_REACH, _FINE_REACH = 4, 3  # so that motion up to 19 px is found
_STILL = 1e-6  # what a pixel of motion must bring; without detail, nothing moves


def block_motion(
    new: Float[Tensor, "plane y x"], old: Float[Tensor, "plane y x"]
) -> Float[Tensor, "2 y x"]:
    """Return m (x, y) such that new(p) is nearly old(p + m), constant over blocks of 8 pixels.

    The mean square difference over 3x3 blocks, all planes together, is smallest; parabolas
    through it give fractions of a pixel.

    Args:
        new: planes of the later picture, values about 0 to 1.
        old: the same planes of the earlier one.
    """
    small = [avg_pool2d(x, _COARSE, ceil_mode=True, count_include_pad=False) for x in (new, old)]
    zero = new.new_zeros(2, *_blocks(small[0], _COARSE_BLOCK))
    rough = _search(small[0], small[1], zero, _COARSE_BLOCK, _COARSE_REACH).round() * _COARSE
    centre = interpolate(rough[None], size=_blocks(new, _FINE_BLOCK))[0]
    fine = _search(new, old, centre, _FINE_BLOCK, _FINE_REACH)
    return _spread(fine, _FINE_BLOCK)[:, : new.shape[-2], : new.shape[-1]]


def moved(
    values: Float[Tensor, "*batch y x"], motion: Float[Tensor, "2 y x"]
) -> Float[Tensor, "*batch y x"]:
    """Return values(p + m), interpolated linearly; 0 where p + m lies outside the picture."""
    height, width = values.shape[-2:]
    x, y = _places(motion)
    grid = torch.stack([2 * x / max(width - 1, 1) - 1, 2 * y / max(height - 1, 1) - 1], dim=-1)
    planes = values.reshape(1, -1, height, width)
    found = grid_sample(planes, grid[None], padding_mode="border", align_corners=True)
    return (found * _inside(x, y, height, width)).reshape(values.shape)


def _places(motion: Float[Tensor, "2 y x"]) -> tuple[Tensor, Tensor]:
    y, x = (torch.arange(n, device=motion.device) for n in motion.shape[-2:])
    return x[None, :] + motion[0], y[:, None] + motion[1]


def _inside(x: Tensor, y: Tensor, height: int, width: int) -> Bool[Tensor, "y x"]:
    return (x >= -0.5) & (x <= width - 0.5) & (y >= -0.5) & (y <= height - 0.5)


def _search(
    new: Tensor, old: Tensor, centre: Float[Tensor, "2 by bx"], block: int, reach: int
) -> Float[Tensor, "2 by bx"]:
    """Return the best motion of every block within `reach` pixels of a first guess."""
    steps = range(-reach, reach + 1)
    costs = torch.stack([_cost(new, old, centre, block, (x, y)) for y in steps for x in steps])
    best, side = costs.argmin(dim=0), len(steps)
    row, column = best // side, best % side
    fraction_x = _fraction(costs, best, 1, (column > 0) & (column < side - 1))
    fraction_y = _fraction(costs, best, side, (row > 0) & (row < side - 1))
    return centre + torch.stack([column - reach + fraction_x, row - reach + fraction_y])


def _cost(
    new: Tensor, old: Tensor, centre: Tensor, block: int, step: tuple[int, int]
) -> Float[Tensor, "by bx"]:
    """Return the mean square difference of every block and its neighbours for one motion."""
    (height, width), (rows, columns) = new.shape[-2:], centre.shape[-2:]
    whole = pad(new[None], (0, columns * block - width, 0, rows * block - height), mode="replicate")
    x, y = _places(_spread(centre, block))
    across = (x + step[0]).long().clamp(0, width - 1)
    down = (y + step[1]).long().clamp(0, height - 1)
    error = (whole[0] - old[:, down, across]).square().mean(dim=0, keepdim=True)
    mean = avg_pool2d(avg_pool2d(error, block), 3, 1, 1, count_include_pad=False)[0]
    return mean + _STILL * (abs(step[0]) + abs(step[1]))


def _fraction(costs: Tensor, best: Tensor, stride: int, inside: Tensor) -> Tensor:
    """Return where the parabola through the best cost and its two neighbours is lowest."""
    last = len(costs) - 1
    before, here, after = (
        costs.gather(0, (best + offset).clamp(0, last)[None])[0] for offset in (-stride, 0, stride)
    )
    bend = before + after - 2 * here
    lowest = (0.5 * (before - after) / bend.clamp(min=1e-9)).clamp(-0.5, 0.5)
    return torch.where(inside & (bend > 1e-9), lowest, 0)


def _blocks(planes: Tensor, block: int) -> tuple[int, int]:
    return -(-planes.shape[-2] // block), -(-planes.shape[-1] // block)


def _spread(values: Tensor, block: int) -> Tensor:
    return values.repeat_interleave(block, -2).repeat_interleave(block, -1)
