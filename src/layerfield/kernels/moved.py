"""What moves as a picture does: planes, and where a frame of a video starts from, in one pass."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.blends import planes_of
from layerfield.kernels.compiled import compiled, native
from layerfield.kernels.radices import LANES

# Pixels of a row are moved `LANES` at once where they move alike, as those of a block do.
move_run = native("layerfield.kernels.moved_lanes", "move_run")


class Rim(NamedTuple):
    """What lies one pixel beyond the edges of planes."""

    left: Float[Tensor, "*batch y"]
    right: Float[Tensor, "*batch y"]
    top: Float[Tensor, "*batch x+2"]
    bottom: Float[Tensor, "*batch x+2"]


class Before(NamedTuple):
    """What a frame has left.

    Args:
        state: s = z + u; larger ones have it in the top left corner.
        even: e.
        carried: c.
        again: factor of z - c.
        low: the lower bound of z.
        high: the upper one.
    """

    state: np.ndarray
    even: np.ndarray
    carried: np.ndarray
    again: np.float32
    low: np.float32
    high: np.float32


def moved_planes(
    values: Float[Tensor, "*batch vy vx"], motion: Float[Tensor, "2 y x"]
) -> Float[Tensor, "*batch y x"]:
    """Return values(p + m), interpolated linearly; what lies outside is that of the nearest edge.

    Args:
        values: of single precision, on a processor; as large as the motion, or with a frame of so
            many pixels on every side.
        motion: m, pixels, x and y.
    """
    height, width = motion.shape[-2:]
    frame = (values.shape[-1] - width) // 2
    made = torch.empty((*values.shape[:-2], height, width), dtype=torch.float32)
    given = planes_of(made), planes_of(values.detach().contiguous()), motion.contiguous().numpy()
    _follow.in_spans(*given, frame, count=height, numbers=made.numel())
    return made


def moved_parts(
    even: Float[Tensor, "*batch ly lx"],
    state: Float[Tensor, "*batch ty tx"],
    even_before: Float[Tensor, "*batch ly lx"],
    carried: Float[Tensor, "*batch ly lx"],
    again: float,
    motion: Float[Tensor, "2 ly lx"],
    rim: Rim,
    bounds: tuple[float, float],
    size: tuple[int, int],
) -> tuple[Float[Tensor, "*batch ty tx"], Float[Tensor, "*batch ly lx"]]:
    """Return the state that a frame starts from, and the layers that are carried to it.

    They are clamp(e_new + (z - e)' + again (z - c)') + u' and clamp(e_new + (z - e)'); what is
    primed is moved. All are of single precision, on a processor.

    Args:
        even: e of the new frame.
        state: s = z + u of the one before; a larger one has it in the top left corner.
        even_before: e of that.
        carried: c of that.
        again: see above.
        motion: from the new frame to the one before, pixels, x and y.
        rim: of u, z - e and again (z - c), one behind the other.
        bounds: of z.
        size: height and width of the state returned, which is 0 beside the layers.

    Raises:
        ValueError: planes, motion or torus that do not fit: loops would go past their ends.
    """
    *batch, height, width = even.shape
    proper = state[..., :height, :width]
    alike = {tuple(each.shape) for each in (even, even_before, carried, proper)}
    small = size[0] < height or size[1] < width
    if len(alike) > 1 or motion.shape[1:] != (height, width) or small:
        found = f"{sorted(alike)}, motion {tuple(motion.shape)} and a torus {size}"
        raise ValueError(f"found planes of {found}, expected all to fit {tuple(even.shape)}")
    made, left = (torch.empty(each, dtype=torch.float32) for each in ((*batch, *size), even.shape))
    planes = (planes_of(each.detach().contiguous()) for each in (state, even_before, carried))
    factors = (np.float32(each) for each in (again, *bounds))
    before = Before._make((*planes, *factors))
    around = tuple(each.detach().reshape(3, -1, each.shape[-1]).numpy() for each in rim)
    given = planes_of(made), planes_of(left), planes_of(even.contiguous()), before
    path = motion.detach().contiguous().numpy()
    rows = len(given[0]) * size[0]
    _move.in_spans(*given, path, around, count=rows, numbers=made.numel())
    return made, left


@compiled
def _follow(made, values, motion, frame, begin, end):
    """Rows of all planes, from and to."""
    number, height, width = values.shape
    last, lowest = np.float32(width - 1), np.float32(height - 1)
    zero, one = np.float32(0), np.float32(1)
    for y in range(begin, end):
        for x in range(made.shape[2]):
            right = min(max(np.float32(x + frame) + motion[0, y, x], zero), last)
            down = min(max(np.float32(y + frame) + motion[1, y, x], zero), lowest)
            left, top = int(right), int(down)
            after, under = min(left + 1, width - 1), min(top + 1, height - 1)
            across, below = right - np.float32(left), down - np.float32(top)
            for plane in range(number):
                upper, lower = values[plane, top], values[plane, under]
                first = (one - across) * upper[left] + across * upper[after]
                second = (one - across) * lower[left] + across * lower[after]
                made[plane, y, x] = (one - below) * first + below * second


@compiled
def _move(made, carried, even, before, motion, around, begin, end):
    """Rows of all planes, one after the other, from and to."""
    (rows, wide), (height, width) = made.shape[1:], even.shape[1:]
    one, factors = np.float32(1), np.empty(7, np.float32)
    factors[4:] = before.again, before.low, before.high
    for place in range(begin, end):
        plane, y = divmod(place, rows)
        if y >= height:
            made[plane, y] = 0
            continue
        made[plane, y, width:] = 0
        for x in range(0, width, LANES):
            right, down = motion[0, y, x], motion[1, y, x]
            left, top = int(np.floor(x + right)), int(np.floor(y + down))
            inside = left >= 0 and left + LANES < width and top >= 0 and top + 1 < height
            if inside and x + LANES <= width and _go_together(motion[:, y, x : x + LANES]):
                across, below = x + right - left, y + down - top
                factors[0], factors[1] = (one - below) * (one - across), (one - below) * across
                factors[2], factors[3] = below * (one - across), below * across
                columns = before.state.shape[2]
                move_run(
                    factors,
                    before.state,
                    (plane * before.state.shape[1] + top) * columns + left,
                    columns,
                    before.even,
                    before.carried,
                    (plane * height + top) * width + left,
                    width,
                    even,
                    carried,
                    (plane * height + y) * width + x,
                    made,
                    place * wide + x,
                )
            else:
                for i in range(x, min(x + LANES, width)):
                    _put(made, carried, even, before, motion, around, plane, y, i)


@compiled
def _go_together(motion):
    """Whether all pixels of a run have the motion of the first."""
    unlike = 0
    for x in range(LANES):
        unlike += (motion[0, x] != motion[0, 0]) | (motion[1, x] != motion[1, 0])
    return unlike == 0


@compiled
def _put(made, carried, even, before, motion, around, plane, y, x):
    """The same of one pixel, which may come from beyond the edges: those stand for all beyond."""
    height, width = even.shape[1:]
    right = min(max(x + motion[0, y, x], np.float32(-1)), np.float32(width))
    down = min(max(y + motion[1, y, x], np.float32(-1)), np.float32(height))
    left, top = min(int(np.floor(right)), width - 1), min(int(np.floor(down)), height - 1)
    across, below = np.float32(right - left), np.float32(down - top)
    dual = other = once_more = np.float32(0)
    for row, share in ((top, np.float32(1) - below), (top + 1, below)):
        for column, part in ((left, np.float32(1) - across), (left + 1, across)):
            a, b, c = _look_up(before, around, plane, row, column, height, width)
            dual += share * part * a
            other += share * part * b
            once_more += share * part * c
    light = even[plane, y, x] + other
    carried[plane, y, x] = min(max(light, before.low), before.high)
    made[plane, y, x] = min(max(light + once_more, before.low), before.high) + dual


@compiled
def _look_up(before, around, plane, y, x, height, width):
    """Return u, z - e and again (z - c) of a pixel, or of what is beyond an edge."""
    left, right, top, bottom = around
    if y < 0:
        return top[0, plane, x + 1], top[1, plane, x + 1], top[2, plane, x + 1]
    if y >= height:
        return bottom[0, plane, x + 1], bottom[1, plane, x + 1], bottom[2, plane, x + 1]
    if x < 0:
        return left[0, plane, y], left[1, plane, y], left[2, plane, y]
    if x >= width:
        return right[0, plane, y], right[1, plane, y], right[2, plane, y]
    state = before.state[plane, y, x]
    iterate = min(max(state, before.low), before.high)
    change = before.again * (iterate - before.carried[plane, y, x])
    return state - iterate, iterate - before.even[plane, y, x], change
