"""A problem at half its size: what is far apart is near there, and a step costs a quarter.

Not all views are asked for. Those whose light paths move by even numbers of pixels have paths
through whole pixels at half size, too, where sweeps are quick; the others would meet layers between
pixels, and what they say of layers that look alike would be blurred.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import torch
from jaxtyping import Float, UInt16
from torch import Tensor
from torch.nn.functional import conv2d, interpolate, max_pool2d, pad

from layerfield.kept_views import LARGEST, KeptViews
from layerfield.kernels.codes import codes_of
from layerfield.kernels.compiled import is_plain, serve
from layerfield.kernels.floors import Seen, floor_words
from layerfield.kernels.half_words import (
    Enlargement,
    HalfWords,
    enlargement_of,
    largest_ratio,
)
from layerfield.kernels.halves import halved_codes, halved_views, refined
from layerfield.problem import Problem
from layerfield.projection import Projection
from layerfield.solve import OutlivesViews, State

_LEAST = 32  # pixels of a view along a side; smaller ones have little of large pixels
_ACROSS = 3  # views
_LEVELS = 4096  # of light; those of bright pixels differ by less than a code
_DARK = 1e-6  # light


# The least that layer pixels may be: in words, or light where compiled loops do not serve.
Floor = UInt16[Tensor, "*batch 1 layer c _ _"] | Float[Tensor, "*batch 1 layer c _ _"]


class Half(NamedTuple):
    """A display at half size.

    Args:
        views: those that are asked for.
        projection: A, from layers to these.
        before: pixels (y, x) of whole size by which its layers begin before those of whole size.
    """

    views: tuple[int, ...]
    projection: Projection
    before: tuple[int, int]


@dataclass(frozen=True, eq=False)
class HalfState(OutlivesViews):
    """The problem at half size, what is known of it, and how many iterations were made of whole.

    Where light adds up, `floor` is that of layers of whole size; see `floor_of`.
    """

    half: Half
    problem: Problem
    state: State
    count: int = 0
    floor: "Floor | None" = None


def half_of(problem: Problem) -> Half | None:
    """Return the display of a problem at half size, for as many views as can be asked for.

    None where views are small, or too few have light paths that move by even numbers of pixels:
    three along each direction at the least, but where there is a single one. Of two there is little
    to learn. Views of weight 0 are none.
    """
    return _half_of(problem.projection, problem.weights, problem.view_size)


@lru_cache
def _half_of(
    projection: Projection, weights: tuple[float, ...], view_size: tuple[int, int]
) -> Half | None:
    if type(projection) is not Projection or min(view_size) < _LEAST:
        return None
    seen = {n: paths for n, paths in enumerate(projection.shifts) if weights[n] > 0}
    chosen = tuple(n for n, paths in seen.items() if _are_even(paths))
    for direction in range(2):
        every, found = (
            {tuple(path[direction] for path in seen[n]) for n in some} for some in (seen, chosen)
        )
        if len(found) < (_ACROSS if len(every) > 1 else 1):
            return None
    shifts = tuple(tuple((y / 2, x / 2) for y, x in seen[n]) for n in chosen)
    my, mx = projection.margin
    margin = -(-my // 2), -(-mx // 2)
    return Half(chosen, Projection(shifts, margin), (2 * margin[0] - my, 2 * margin[1] - mx))


def _are_even(paths: Sequence[tuple[float, float]]) -> bool:
    return all(shift % 2 == 0 for path in paths for shift in path)


def at_half_size(problem: Problem, half: Half) -> Problem:
    """Return the problem of showing means of pixels on layers of half size.

    Those of 2x2 pixels would change with the first pixel: layers of a picture that moves by one
    would move less alike. Where light adds up codes stay such: they are summed up as whole numbers.
    Where it is multiplied they are rounded to codes of 8 bits again, or to light of 16, as each
    sweep reads them all: that is within 1e-4 dB of layers that nothing was rounded for.
    """
    weights = tuple(problem.weights[n] for n in half.views)
    views, stored = problem.views, problem.views.stored
    is_light, are_codes = views.table is not None, stored.dtype == torch.uint8
    if not (are_codes and serve(views.like)) or (is_light and problem.link.is_sum):
        views = KeptViews(_halved(views, half.views))
    elif problem.link.is_sum:
        views = KeptViews(halved_codes(stored, half.views))
    else:
        dtype = torch.uint16 if is_light else torch.uint8
        views = KeptViews(codes_of(_halved(views, half.views), LARGEST[dtype], dtype))
    return replace(
        problem, projection=half.projection, views=views, weights=weights, whole=problem.constants
    )


def floor_of(problem: Problem, half: Half, small: Problem, floor: Floor | None) -> Floor:
    """Return the least that pixels of half size may be, where light adds up.

        floor = max(e_half - min(e - floor of whole size), 0),  of 4x4 pixels of whole size

    So what changes, up(Q - e of half size), could be added to e and leave none below its own floor:
    up mixes four of half size, and each looks at all pixels it is part of. How dark the darkest are
    says in which layers light may lie. Large pixels show means alone, and where their edges lie
    decides how dark they are: without a floor layers of a scene moved by one pixel are less alike
    by 5 dB.

    Args:
        problem: at its whole size.
        half: what it is at half size.
        small: at half size.
        floor: of whole size, if anything but 0.
    """
    words, fewer = problem.constants.words, small.constants.words
    if words is not None and fewer is not None and not is_plain():
        whole = Seen(words, problem.back_projected_words, floor)
        return floor_words(whole, Seen(fewer, small.back_projected_words), half.before)
    room = problem.even_start() - (0 if floor is None else floor)
    room = torch.where(problem.constants.even_shares > 0, room, math.inf)
    height, width = small.layer_shape[-2:]
    (rows, columns), (top, left) = room.shape[-2:], half.before
    beside = 1 + left, 2 * width + 1 - left - columns, 1 + top, 2 * height + 1 - top - rows
    planes = pad(room.flatten(0, -3)[None], beside, value=math.inf)
    least = -max_pool2d(-planes, 4, stride=2)
    start = small.even_start()
    made = (start - least.view(start.shape)).clamp(min=0)
    return torch.where(small.constants.even_shares > 0, made, 0)


@dataclass(frozen=True, eq=False)
class Enlarged:
    """Layers of half size brought to whole size, where light adds up; made when asked for.

        P = e up(Q / e of half size),  with e the balanced start

    Args:
        problem: at its whole size.
        half: what it is at half size.
        small: at half size.
        found: Q, or None where it is known in words alone.
        found_words: Q in words, if it is known.
        floor: the least that P may be, if anything but 0.
    """

    problem: Problem
    half: Half
    small: Problem
    found: Float[Tensor, "*batch 1 layer c hy hx"] | None
    found_words: UInt16[Tensor, "*batch 1 layer c hy words"] | None = None
    floor: Floor | None = None

    @property
    def layers(self) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        """P, before it is clamped."""
        assert self.found is not None
        seen, shares = self.problem.back_projected, self.problem.constants.even_shares
        start = torch.where(shares > 0, seen * shares, self.small.even_shares[1])
        words, fewer = self.problem.constants.words, self.small.constants.words
        faint = _DARK if fewer is None else 1 / fewer.most
        ratio = (self.found + faint) / (self.small.even_start() + faint)
        ratio = ratio.clamp(max=math.inf if words is None else largest_ratio(words))
        return start * _twice(ratio, self.half.before, seen.shape)

    @property
    def words(self) -> Enlargement | None:
        """What compiled loops make P of in words, row by row; None where Q is in none."""
        words, small = self.problem.constants.words, self.small.constants.words
        if words is None or small is None or self.found_words is None:
            return None
        half = HalfWords(small, self.found_words, self.small.back_projected_words)
        return enlargement_of(words, half, self.small.rest_of_words, self.half.before)


def at_whole_size_of_products(
    problem: Problem, half: Half, layers: Float[Tensor, "*batch 1 layer c hy hx"], small: Problem
) -> Float[Tensor, "*batch 1 layer c ly lx"]:
    """Return layers of half size brought to whole size, where light is multiplied.

        P = e up(Q / e of half size),    e_k = (what the viewers of layer k see on average)^(1/K)

    Means are those of codes, whose light is then looked up: it makes no difference to what
    follows, and takes a third of the time.

    Args:
        problem: at its whole size.
        half: what it is at half size.
        layers: Q.
        small: at half size.
    """
    number = problem.layer_count
    ratio = layers / (small.even_start() * number).clamp(min=_DARK).pow(1 / number)
    codes = replace(problem, views=KeptViews(problem.views.stored))
    law = _root_of_light(problem.views.table, number).to(layers)
    seen, (shares, rest) = codes.back_projected, codes.even_shares
    if serve(seen, ratio):
        return refined(seen, (number * shares, number * rest), ratio, half.before, law)
    start = number * torch.where(shares > 0, seen * shares, rest)
    levels = (start * (len(law) - 1)).round().long().clamp(0, len(law) - 1)
    return law[levels] * _twice(ratio, half.before, seen.shape)


def _twice(change: Tensor, before: tuple[int, int], shape: Sequence[int]) -> Tensor:
    """Return what is between pixels of half size, as large as layers."""
    (top, left), (height, width) = before, shape[-2:]
    wide = interpolate(change.flatten(0, -3)[None], scale_factor=2, mode="bilinear")[0]
    layers = wide.view(*change.shape[:-2], *wide.shape[-2:])
    return layers[..., top : top + height, left : left + width]


def _root_of_light(table: Tensor | None, number: int) -> Float[Tensor, " level"]:
    """Return the root of what codes stand for, evenly from the least to the largest."""
    light = torch.linspace(0, 1, _LEVELS, dtype=torch.float32)
    if table is not None:
        line = table.float()[None, None].cpu()
        light = interpolate(line, size=_LEVELS, mode="linear", align_corners=True)[0, 0]
    return light.clamp(min=_DARK).pow(1 / number)


def _halved(views: KeptViews, chosen: Sequence[int]) -> Float[Tensor, "*batch some c hy hx"]:
    if serve(views.like):
        share = 1 / LARGEST[views.stored.dtype] if views.is_whole else 1.0
        return halved_views(views.stored, chosen, views.table, share)
    return torch.stack([_mean(views.view(n)) for n in chosen], dim=-4)


def _mean(view: Float[Tensor, "*batch c y x"]) -> Float[Tensor, "*batch c hy hx"]:
    height, width = view.shape[-2:]
    planes = pad(
        view.reshape(1, -1, height, width), (1, 1 + width % 2, 1, 1 + height % 2), "replicate"
    )
    shares = torch.tensor([1, 3, 3, 1], dtype=view.dtype) / 8
    kernel = (shares[:, None] * shares)[None, None]
    made = conv2d(planes.transpose(0, 1), kernel, stride=2)
    return made.reshape(*view.shape[:-2], *made.shape[-2:])
