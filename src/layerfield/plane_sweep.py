"""Disparity along one line of views by plane sweep, and what occlusion says about its sign.

A line is handled as a horizontal one: parallax along x. A point at x of the reference view is at
`x - d s` in the view s steps to the right of it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

_WINDOW = 2  # radius of the matching window, px
_OUTLIER = 0.1  # differences of views count up to this
_TIE = 5e-4  # costs closer than this are equal: flat surfaces match anywhere
_RATIO = 0.5  # a match counts if its cost is below this part of the mean cost of all candidates
_TEXTURE = 0.02  # root mean square gradient along x that makes a pixel textured
_COLOUR = 0.1  # points whose colours differ by this can be told apart
_MATCH = 0.04  # and a point is taken as seen if its colour is met this closely
_EDGE = 0.05  # gradient of a contour


@dataclass(frozen=True, eq=False)
class Line:
    """Views side by side at equal distances.

    Args:
        views: at most a handful on either side of the reference.
        reference: index of the view whose disparities are estimated.
        scale: size of the views relative to the original ones.
    """

    views: Float[Tensor, "view c y x"]
    reference: int
    scale: float = 1.0

    @property
    def others(self) -> list[tuple[int, int]]:
        """Index and step of every view but the reference."""
        return [(i, i - self.reference) for i in range(len(self.views)) if i != self.reference]


@dataclass(frozen=True, eq=False)
class Sweep:
    """The best disparity of every pixel of the reference view.

    Args:
        candidates: disparities that were tried, ascending, in original pixels.
        best: index of the candidate that was best.
        disparity: the same in original pixels, refined between candidates.
        distinct: the match is much better than most other candidates.
        textured: there is texture along x, and both sides of the line agree.
    """

    candidates: Float[Tensor, " d"]
    best: Int[Tensor, "y x"]
    disparity: Float[Tensor, "y x"]
    distinct: Bool[Tensor, "y x"]
    textured: Bool[Tensor, "y x"]


def sweep(line: Line, candidates: Float[Tensor, " d"]) -> Sweep:
    """Try all candidates at every pixel.

    The cost is the windowed difference to the reference view, for the views before and after it
    apart; the better side counts, so that a point hidden on one side is still matched.

    Args:
        line: the views.
        candidates: disparities in original pixels, ascending and equally spaced.
    """
    scaled = [float(d) * line.scale for d in candidates]
    grey = replace(line, views=line.views.mean(1, keepdim=True))  # colour adds time, little else
    sides = [
        torch.stack([_cost(grey, side, d) for d in scaled])
        for sign in (-1, 1)
        if (side := [(i, s) for i, s in line.others if s * sign > 0])
    ]
    cost = sides[0] if len(sides) == 1 else torch.minimum(sides[0], sides[1])
    best, distinct = _best(cost)
    consistent = (sides[0].argmin(0) - sides[-1].argmin(0)).abs() <= 2
    return Sweep(
        candidates=candidates,
        best=best,
        disparity=_refine(candidates, cost, best),
        distinct=distinct,
        textured=distinct & consistent & (_texture(grey.views[grey.reference]) > _TEXTURE),
    )


def hidden_point_votes(line: Line, swept: Sweep) -> tuple[int, int]:
    """Where two points fall on the same pixel of a view, see which of them is visible there.

    Returns:
        How often it was the one with the larger disparity (as it should be), and the smaller one.
    """
    width = line.views.shape[-1]
    disparity = swept.candidates[swept.best] * line.scale
    columns = torch.arange(width).expand_as(disparity)
    errors = {s: _error(line, i, columns - disparity * s) for i, s in line.others}
    normal = inverted = 0
    for _, step in line.others:
        across = [error for s, error in errors.items() if s * step < 0]
        if not across:
            continue
        seen_across = torch.stack(across).mean(0) < _MATCH
        target = (columns - disparity * step).round().long()
        usable = swept.distinct & seen_across & (target >= 0) & (target < width)
        key = swept.best * width + columns
        pairs = _collisions(key, torch.where(usable, target, width), width)
        votes = _who_is_seen(line, swept, errors[step], pairs, abs(step))
        normal, inverted = normal + votes[0], inverted + votes[1]
    return normal, inverted


def contour_votes(line: Line, swept: Sweep) -> tuple[int, int]:
    """At contours between two disparities, see which of them the contour moves with.

    Returns:
        How often with the larger disparity (an occluder owns its outline), and the smaller one.
    """
    reach = _WINDOW + 3
    gradient = _gradient(line.views[line.reference]).mean(0)
    peak = (gradient > _EDGE) & (gradient >= gradient.roll(1, -1))
    peak &= gradient >= gradient.roll(-1, -1)
    margin = 2 * reach
    peak[:, :margin] = peak[:, -margin:] = False
    disparity = swept.candidates[swept.best]
    left, right = disparity.roll(reach, -1), disparity.roll(-reach, -1)
    known = swept.distinct & swept.distinct.roll(reach, -1) & swept.distinct.roll(-reach, -1)
    jump = (left - right).abs()
    span = float(swept.candidates[-1] - swept.candidates[0])
    counted = peak & known & (jump > 0.2 * span)
    near = (disparity - torch.maximum(left, right)).abs() < 0.25 * jump
    far = (disparity - torch.minimum(left, right)).abs() < 0.25 * jump
    return int((counted & near).sum()), int((counted & far).sum())


def _cost(line: Line, side: Sequence[tuple[int, int]], d: float) -> Float[Tensor, "y x"]:
    reference = line.views[line.reference]
    total = torch.zeros_like(reference)
    for index, step in side:
        difference = (_displaced(line.views[index], -d * step) - reference).abs()
        total += difference.clamp_(max=_OUTLIER)
    return _box(total / len(side))[0]


def _best(cost: Float[Tensor, "d y x"]) -> tuple[Int[Tensor, "y x"], Bool[Tensor, "y x"]]:
    """Return the middle of the equally good candidates, and whether it stands out."""
    least = cost.amin(0)
    good = (cost <= least + _TIE).to(torch.uint8)
    first = good.argmax(0)
    last = len(cost) - 1 - good.flip(0).argmax(0)
    narrow = last - first <= max(1, len(cost) // 8)
    return (first + last) // 2, narrow & (least < _RATIO * cost.mean(0))


def _displaced(view: Float[Tensor, "c y x"], offset: float) -> Float[Tensor, "c y x"]:
    """Return view(x + offset), linear between pixels, edges repeated."""
    whole = math.floor(offset)
    places = torch.arange(view.shape[-1]) + whole
    last = view.shape[-1] - 1
    before = view.index_select(-1, places.clamp(0, last))
    if offset == whole:
        return before
    return torch.lerp(before, view.index_select(-1, (places + 1).clamp(0, last)), offset - whole)


def _box(image: Float[Tensor, "c y x"]) -> Float[Tensor, "c y x"]:
    size = 2 * _WINDOW + 1
    return functional.avg_pool2d(image[None], size, 1, _WINDOW, count_include_pad=False)[0]


def _gradient(image: Float[Tensor, "c y x"]) -> Float[Tensor, "c y x"]:
    gradient = torch.zeros_like(image)
    gradient[..., 1:-1] = (image[..., 2:] - image[..., :-2]).abs() / 2
    return gradient


def _texture(image: Float[Tensor, "c y x"]) -> Float[Tensor, "y x"]:
    return _box(_gradient(image).square())[0].sqrt()


def _refine(
    candidates: Float[Tensor, " d"], cost: Float[Tensor, "d y x"], best: Int[Tensor, "y x"]
) -> Float[Tensor, "y x"]:
    if len(candidates) < 3:
        return candidates[best]
    middle = best.clamp(1, len(candidates) - 2)[None]
    before, at, after = (cost.gather(0, middle + k)[0] for k in (-1, 0, 1))
    bend = (before - 2 * at + after).clamp(min=1e-9)
    fraction = ((before - after) / (2 * bend)).clamp(-0.5, 0.5)
    inside = middle[0] == best
    return candidates[best] + torch.where(inside, fraction, 0) * (candidates[1] - candidates[0])


def _error(line: Line, index: int, x: Float[Tensor, "y x"]) -> Float[Tensor, "y x"]:
    """Return how far the view at x is from the colours of the reference."""
    view = line.views[index]
    first = x.floor().long()
    last = view.shape[-1] - 1
    before, after = (
        view.gather(-1, (first + k).clamp(0, last).expand_as(view).contiguous()) for k in (0, 1)
    )
    seen = torch.lerp(before, after, x - first)
    return (seen - line.views[line.reference]).abs().mean(0)


def _collisions(
    key: Int[Tensor, "y x"], target: Int[Tensor, "y x"], width: int
) -> tuple[Int[Tensor, "y x"], Int[Tensor, "y x"]]:
    """Return the largest and smallest key that falls on each pixel, -1 where there are not two."""
    shape = (len(key), width + 1)  # what misses the view is collected in the last column
    most = torch.full(shape, -1).scatter_reduce(1, target, key, "amax")[:, :width]
    unset = torch.iinfo(torch.long).max
    least = torch.full(shape, unset).scatter_reduce(1, target, key, "amin")[:, :width]
    two = most > least
    return torch.where(two, most, -1), torch.where(two, least, -1)


def _who_is_seen(
    line: Line,
    swept: Sweep,
    error: Float[Tensor, "y x"],
    pairs: tuple[Int[Tensor, "y x"], Int[Tensor, "y x"]],
    distance: int,
) -> tuple[int, int]:
    width = line.views.shape[-1]
    two = pairs[0] >= 0
    place = [key.clamp(min=0) % width for key in pairs]
    disparity = [swept.candidates[key.clamp(min=0) // width] * line.scale for key in pairs]
    reference = line.views[line.reference]
    colour = [reference.gather(-1, p.expand_as(reference).contiguous()) for p in place]
    near, far = (error.gather(-1, p) for p in place)
    apart = (disparity[0] - disparity[1]) * distance > 1
    counted = two & apart & ((colour[0] - colour[1]).abs().mean(0) > _COLOUR)
    normal = counted & (near < _MATCH) & (far > near + _COLOUR / 2)
    inverted = counted & (far < _MATCH) & (near > far + _COLOUR / 2)
    return int(normal.sum()), int(inverted.sum())
