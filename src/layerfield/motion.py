"""Where things went from one picture to the next: block matching, coarse to fine."""

from collections.abc import Callable
from itertools import product

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import avg_pool1d, avg_pool2d, grid_sample, interpolate, pad

from layerfield.kernels.block_costs import BLOCK, HALF, block_costs, cheapest, neighbour_costs
from layerfield.kernels.compiled import serve
from layerfield.kernels.moved import Rim, moved_planes

_NEXT = (-1, 0, 1)
_AROUND = tuple(sorted(((y, x) for y in _NEXT for x in _NEXT), key=any))  # a block itself is first
_ROUGH_BLOCK = 4  # pixels of a quarter of the size
_ROUGH_REACH, _HALF_REACH, _FULL_REACH = 4, 1, 2  # so that 20 px are found
_NEAR = 5  # pixels from an edge, and along it
_WIDE = 1 << 16  # no motion goes so far
_STRAY = 1e-3  # what a pixel of motion unlike that of most must bring; where all is even, none does


def block_motion(new: Float[Tensor, "y x"], old: Float[Tensor, "y x"]) -> Float[Tensor, "2 y x"]:
    """Return m (x, y) such that new(p) is nearly old(p + m), constant over 8x4 pixels.

    Blocks of 8x8 pixels, at a quarter of the size 16x16, take the motion with the least mean square
    difference: of 81 at that size, then of nine at half of it and of 25 at full size; a parabola
    gives fractions of a pixel. Blocks without much detail move as most of the others do. At last
    each half of a block takes the best of its block's motion and those of the eight around it:
    edges of things run through blocks.

    Args:
        new: the later picture, values about 0 to 1.
        old: the earlier one.
    """
    half_new, half_old = _halved(new), _halved(old)
    quarter = _halved(half_new)
    still = torch.zeros(2, *_blocks(quarter, _ROUGH_BLOCK), dtype=torch.long, device=new.device)
    motion = _found(quarter, _halved(half_old), still, _ROUGH_BLOCK, _ROUGH_REACH)[0]
    centre = _doubled(motion, _blocks(half_new, BLOCK))
    motion = _found(half_new, half_old, centre, BLOCK, _HALF_REACH)[0]
    centre = _doubled(motion, _blocks(new, BLOCK))
    whole, fraction = _found(new, old, centre, BLOCK, _FULL_REACH)
    halves = _of_neighbours(new, old, whole + fraction)
    motion = halves.repeat_interleave(HALF, -2).repeat_interleave(BLOCK, -1)
    return motion[:, : new.shape[-2], : new.shape[-1]]


def moved(
    values: Float[Tensor, "*batch vy vx"], motion: Float[Tensor, "2 y x"]
) -> Float[Tensor, "*batch y x"]:
    """Return values(p + m), interpolated linearly; what lies outside is that of the nearest edge.

    Args:
        values: as large as the motion, or with a frame of so many pixels on every side.
        motion: m.
    """
    if serve(values, motion):
        return moved_planes(values, motion)
    height, width = values.shape[-2:]
    frame = (width - motion.shape[-1]) // 2
    x, y = _places(motion)
    across, down = 2 / max(width - 1, 1), 2 / max(height - 1, 1)
    grid = torch.stack([across * (x + frame) - 1, down * (y + frame) - 1], dim=-1)
    planes = values.reshape(1, -1, height, width)
    found = grid_sample(planes, grid[None], padding_mode="border", align_corners=True)
    return found.reshape(*values.shape[:-2], *motion.shape[-2:])


def framed(values: Float[Tensor, "*batch y x"]) -> Float[Tensor, "*batch y+2 x+2"]:
    """Return values with one pixel more on every side: means of what is near that edge."""
    rim = rim_of(lambda y, x: values[..., y, x])
    wide = torch.cat([rim.left[..., None], values, rim.right[..., None]], dim=-1)
    return torch.cat([rim.top[..., None, :], wide, rim.bottom[..., None, :]], dim=-2)


def rim_of(part: Callable[[slice, slice], Float[Tensor, "*batch y x"]]) -> Rim:
    """Return what lies around values: means of what is near that edge.

    Args:
        part: returns rows and columns of them.
    """
    whole, first, last = slice(None), slice(_NEAR), slice(-_NEAR, None)
    left, right = (_mean_along(part(whole, each).mean(dim=-1)) for each in (first, last))
    beside = [
        torch.cat([left[..., rows, None], part(rows, whole), right[..., rows, None]], dim=-1)
        for rows in (first, last)
    ]
    top, bottom = (_mean_along(each.mean(dim=-2)) for each in beside)
    return Rim(left, right, top, bottom)


def comes_from_inside(motion: Float[Tensor, "2 y x"]) -> Bool[Tensor, "y x"]:
    """Return where p + m lies in the picture."""
    height, width = motion.shape[-2:]
    x, y = _places(motion)
    return (x >= -0.5) & (x <= width - 0.5) & (y >= -0.5) & (y <= height - 0.5)


def _places(motion: Tensor) -> tuple[Float[Tensor, "y x"], Float[Tensor, "y x"]]:
    """Return x and y of p + m."""
    height, width = motion.shape[-2:]
    x = torch.arange(width, device=motion.device) + motion[0]
    return x, torch.arange(height, device=motion.device)[:, None] + motion[1]


def _mean_along(line: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n"]:
    lines = line.reshape(1, -1, line.shape[-1])
    mean = avg_pool1d(lines, 2 * _NEAR - 1, 1, _NEAR - 1, count_include_pad=False)
    return mean.reshape(line.shape)


def _halved(picture: Float[Tensor, "y x"]) -> Float[Tensor, "hy hx"]:
    return avg_pool2d(picture[None], 2, ceil_mode=True, count_include_pad=False)[0]


def _doubled(motion: Int[Tensor, "2 by bx"], blocks: tuple[int, int]) -> Int[Tensor, "2 cy cx"]:
    return 2 * interpolate(motion[None].float(), size=blocks)[0].long()


def _found(
    new: Tensor, old: Tensor, centre: Int[Tensor, "2 by bx"], block: int, reach: int
) -> tuple[Int[Tensor, "2 by bx"], Float[Tensor, "2 by bx"]]:
    """Return the best motion of every block within `reach` pixels of a first guess.

    Returns:
        Whole pixels, and the fraction to be added.
    """
    side, costs = 2 * reach + 1, _costs(new, old, centre, block, reach)
    tried = centre[:, None] + torch.arange(-reach, reach + 1, device=centre.device)[:, None, None]
    x, y = (tried - _most(centre, costs, reach)[:, None, None, None]).abs()
    costs = costs + _STRAY * (x + y[:, None]).flatten(0, 1)
    best = _cheapest(costs)
    row, column = best // side, best % side
    across = _fraction(costs, best, 1, (column > 0) & (column < side - 1))
    down = _fraction(costs, best, side, (row > 0) & (row < side - 1))
    return centre + torch.stack([column, row]) - reach, torch.stack([across, down])


def _costs(
    new: Tensor, old: Tensor, centre: Tensor, block: int, reach: int
) -> Float[Tensor, "step by bx"]:
    """Return the mean square difference of every block for all motions."""
    if serve(new, old):
        return block_costs(new, old, centre, block, reach)
    (height, width), (rows, columns) = new.shape, centre.shape[-2:]
    fill = (0, columns * block - width, 0, rows * block - height)
    tiles = pad(new[None], fill, mode="replicate")[0]
    tiles = tiles.unflatten(1, (-1, block)).unflatten(0, (-1, block)).transpose(1, 2)
    span = torch.arange(-reach, block + reach, device=centre.device)
    x = centre[0] + block * torch.arange(columns, device=centre.device)
    y = centre[1] + block * torch.arange(rows, device=centre.device)[:, None]
    x = (x[..., None] + span).clamp(0, width - 1)
    y = (y[..., None] + span).clamp(0, height - 1)
    windows = old[y[..., :, None], x[..., None, :]].unfold(2, block, 1).unfold(3, block, 1)
    steps = product(range(2 * reach + 1), repeat=2)
    # One after the other: what is between stays in the cache.
    errors = [(windows[:, :, i, j] - tiles).square_().mean(dim=(-2, -1)) for i, j in steps]
    return torch.stack(errors)


def _of_neighbours(
    new: Tensor, old: Tensor, motion: Float[Tensor, "2 by bx"]
) -> Float[Tensor, "2 hy bx"]:
    """Return the best motion of each half of a block: of the block, or of one next to it."""
    best = _cheapest(_costs_of_neighbours(new, old, motion))
    down, right = torch.tensor(_AROUND, device=motion.device)[best].unbind(dim=-1)
    return _beside(motion, down, right)


def _costs_of_neighbours(
    new: Tensor, old: Tensor, motion: Float[Tensor, "2 by bx"]
) -> Float[Tensor, "step hy bx"]:
    """Return the mean square difference of each half of a block for the motions around."""
    if serve(new, old):
        return neighbour_costs(new, old, motion, _AROUND)
    height, width = new.shape
    halves, costs = motion.new_zeros(-(-height // HALF), motion.shape[-1], dtype=torch.long), []
    for down, right in _AROUND:
        tried = _beside(motion, halves + down, halves + right)
        tried = tried.repeat_interleave(HALF, -2).repeat_interleave(BLOCK, -1)
        errors = (moved(old, tried[:, :height, :width]) - new).square_()
        part = avg_pool2d(errors[None], (HALF, BLOCK), ceil_mode=True, count_include_pad=False)
        costs.append(part[0])
    return torch.stack(costs)


def _beside(
    motion: Float[Tensor, "2 by bx"], down: Int[Tensor, "hy bx"], right: Int[Tensor, "hy bx"]
) -> Float[Tensor, "2 hy bx"]:
    """Return the motion of blocks so far from that of a half, at an edge that of the nearest."""
    halves, columns = (torch.arange(n, device=motion.device) for n in down.shape)
    y, x = halves[:, None] // 2 + down, columns + right
    return motion[:, y.clamp(0, motion.shape[-2] - 1), x.clamp(0, motion.shape[-1] - 1)]


def _most(centre: Int[Tensor, "2 by bx"], costs: Tensor, reach: int) -> Int[Tensor, " 2"]:
    """Return the motion of most of the blocks that have more detail than others."""
    best, side = _cheapest(costs), 2 * reach + 1
    spread = costs.amax(dim=0) - costs.gather(0, best[None])[0]
    chosen = centre + torch.stack([best % side, best // side]) - reach
    voting = chosen[:, spread >= spread.mean()]
    return voting[:, (voting[0] * _WIDE + voting[1]).mode().indices]


def _cheapest(costs: Float[Tensor, "step by bx"]) -> Int[Tensor, "by bx"]:
    """Return the number of the lowest cost of every block, the first of those that are alike."""
    return cheapest(costs) if serve(costs) else costs.argmin(dim=0)


def _fraction(costs: Tensor, best: Tensor, stride: int, inside: Tensor) -> Tensor:
    """Return where the parabola through the best cost and its two neighbours is lowest."""
    last = len(costs) - 1
    before, here, after = (
        costs.gather(0, (best + offset).clamp(0, last)[None])[0] for offset in (-stride, 0, stride)
    )
    bend = before + after - 2 * here
    lowest = (0.5 * (before - after) / bend.clamp(min=1e-9)).clamp(-0.5, 0.5)
    return torch.where(inside & (bend > 1e-9), lowest, 0)


def _blocks(picture: Tensor, block: int) -> tuple[int, int]:
    return -(-picture.shape[-2] // block), -(-picture.shape[-1] // block)
