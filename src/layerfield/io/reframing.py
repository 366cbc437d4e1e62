"""Which part of every view to keep: shift, scale and crop."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Num
from torch import Tensor
from torch.nn import functional

from layerfield.geometry import Point
from layerfield.io.options import Crop, FieldOptions, Grid

_WHOLE = 1e-6  # shifts closer to a whole pixel than this are whole


@dataclass(frozen=True)
class Reframing:
    """Shift, scale and crop, worked out for one grid and size of the views.

    Args:
        offsets: by how much each view is moved, (y, x) pixels to the bottom right.
        window: first and last + 1 (y, x) pixel that all moved views cover.
        size: (y, x) after scaling.
        crop: the rectangle kept of that, or everything.
    """

    offsets: tuple[tuple[float, float], ...]
    window: tuple[tuple[int, int], tuple[int, int]]
    size: tuple[int, int]
    crop: tuple[slice, slice]

    @property
    def is_cut(self) -> bool:
        """Whether pixels are merely chosen, so that whole numbers stay what they are."""
        window = tuple(end - first for first, end in self.window)
        return window == self.size and all(o.is_integer() for yx in self.offsets for o in yx)

    def __call__(self, view: Num[Tensor, "c y x"], index: int) -> Num[Tensor, "c y2 x2"]:
        """Return what is kept of the view with this index; of floats unless `is_cut`."""
        for axis, offset, (first, end) in zip(
            (1, 2), self.offsets[index], self.window, strict=True
        ):
            view = _move(view, axis, offset, (first, end))
        if tuple(view.shape[1:]) != self.size:
            view = functional.interpolate(
                view[None], self.size, mode="bicubic", antialias=True, align_corners=False
            )[0].clamp(0, 1)
        return view[:, self.crop[0], self.crop[1]]


def reframing_of_eyes(
    plan: Reframing, grid: Grid, full: tuple[int, int], eyes: Sequence[Point], shift: float
) -> tuple[Reframing, tuple[Point, ...]]:
    """Reframe what eyes see as the views of a grid are reframed.

    Args:
        plan: of the grid.
        grid: (rows, columns) of it.
        full: (y, x) of a view as it is stored.
        eyes: (x, y) of every eye, in view steps from the centre of the grid.
        shift: of the plan.

    Returns:
        The plan, and the eyes that see all of what the views of the grid have in common.
    """
    rows, columns = ((count - 1) / 2 - (count - 1) // 2 for count in grid)
    offsets = {(x, y): (_near(shift * (y + rows)), _near(shift * (x + columns))) for x, y in eyes}
    kept = {
        eye: offset
        for eye, offset in offsets.items()
        if all(
            math.ceil(o) <= first and end <= math.floor(length - 1 + o) + 1
            for o, (first, end), length in zip(offset, plan.window, full, strict=True)
        )
    }
    return replace(plan, offsets=tuple(kept.values())), tuple(kept)


def plan_reframing(grid: Grid, size: tuple[int, int], options: FieldOptions) -> Reframing:
    """Work out shift, scale and crop.

    A point of disparity d has disparity d - shift afterwards: the view i steps to the right of the
    central one becomes L'(x) = L(x - shift i), and alike downward. With an even number of views
    the one before the middle stays in place, so that whole shifts stay whole.

    Args:
        grid: (rows, columns) of the views.
        size: (y, x) of a view.
        options: `shift`, `scale` and `crop` matter.

    Raises:
        ValueError: the shift leaves nothing, the scale less than a pixel, or the crop is outside.
    """
    lines = [list(_offsets(count, options.shift)) for count in grid]
    window = _common_window(size, lines, options.shift)
    scaled = tuple(max(1, round((end - first) * options.scale)) for first, end in window)
    return Reframing(
        offsets=tuple((y, x) for y in lines[0] for x in lines[1]),
        window=window,
        size=(scaled[0], scaled[1]),
        crop=_rectangle(options.crop, (scaled[0], scaled[1])),
    )


def _offsets(count: int, shift: float) -> Iterator[float]:
    for step in range(count):
        yield _near(shift * (step - (count - 1) // 2))


def _near(offset: float) -> float:
    near = round(offset)
    return float(near) if abs(offset - near) < _WHOLE else offset


def _common_window(
    size: tuple[int, int], lines: list[list[float]], shift: float
) -> tuple[tuple[int, int], tuple[int, int]]:
    window = []
    for length, offsets in zip(size, lines, strict=True):
        first = max(0, math.ceil(max(offsets)))
        end = min(length, math.floor(length - 1 + min(offsets)) + 1)
        if first >= end:
            raise ValueError(
                f"shift is {shift:g} px per view, which leaves no area that all {len(offsets)} "
                f"views of {size[1]}x{size[0]} px cover; give a smaller one, or fewer views"
            )
        window.append((first, end))
    return window[0], window[1]


def _rectangle(crop: Crop | None, size: tuple[int, int]) -> tuple[slice, slice]:
    height, width = size
    if crop is None:
        return slice(0, height), slice(0, width)
    x, y = crop.corner or ((width - crop.width) // 2, (height - crop.height) // 2)
    if min(x, y) < 0 or x + crop.width > width or y + crop.height > height:
        corner = f" at {x},{y}" if crop.corner else ""
        raise ValueError(
            f"crop is {crop.width}x{crop.height}{corner}, but the views are {width}x{height} px "
            "there; give a rectangle inside"
        )
    return slice(y, y + crop.height), slice(x, x + crop.width)


def _move(
    view: Num[Tensor, "c y x"], axis: int, offset: float, window: tuple[int, int]
) -> Num[Tensor, "c y2 x2"]:
    first = window[0] - math.ceil(offset)
    count = window[1] - window[0]
    fraction = math.ceil(offset) - offset
    if fraction == 0:
        return view.narrow(axis, first, count)
    places = torch.arange(first, first + count)
    moved = torch.zeros_like(view.narrow(axis, 0, count))
    for tap, weight in zip(range(-1, 3), _cubic(fraction), strict=True):
        places_of_tap = (places + tap).clamp(0, view.shape[axis] - 1)
        moved += weight * view.index_select(axis, places_of_tap)
    return moved.clamp(0, 1)


def _cubic(t: float) -> tuple[float, float, float, float]:
    """Weights of the pixels at -1, 0, 1, 2 for the value at t between 0 and 1 (Keys, a = -1/2)."""
    return (
        (-(t**3) + 2 * t**2 - t) / 2,
        (3 * t**3 - 5 * t**2 + 2) / 2,
        (-3 * t**3 + 4 * t**2 + t) / 2,
        (t**3 - t**2) / 2,
    )
