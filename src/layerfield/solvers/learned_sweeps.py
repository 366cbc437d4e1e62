"""Sweeps in words, layer by layer, where views stand in a grid: from half size, or a step."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.half_size import (
    Enlarged,
    Floor,
    HalfState,
    at_half_size,
    floor_of,
    half_of,
)
from layerfield.kept_views import KeptViews
from layerfield.kernels.compiled import is_plain
from layerfield.kernels.gray_words import gray_words
from layerfield.kernels.half_words import Enlargement, HalfWords, balanced, coloured
from layerfield.kernels.word_sweeps import LayerWords, swept
from layerfield.kernels.words import Words
from layerfield.links import Additive
from layerfield.problem import Problem
from layerfield.solve import OutlivesViews
from layerfield.solvers.learned_admm import LearnedAdmm, LearnedState, Unbegun
from layerfield.solvers.sweeps import Sweeps, SweepsState, best_layer

_ROUNDING = 10  # numbers of a word for each sweep: of more, what rounding leaves is seen
_DARK = 1e-6  # light
_BRIGHTEST = 1 + 1e-5  # of a view; sums of floats are rounded


@dataclass(frozen=True, eq=False)
class Balanced(OutlivesViews):
    """No sweep was made at half size: layers are the balanced start. Pixels have a floor there."""

    floor: Floor


@dataclass(frozen=True, eq=False)
class SweptState:
    """Layers after sweeps, how many those are, and what goes on.

    That is words, or P of one sweep ago where there are none, or the state of sweeps in floats.
    Layers of half size are known in words alone; there pixels have a floor, see `floor_of`.
    """

    layers: Float[Tensor, "*batch 1 layer c ly lx"] | None = None
    count: int = 0
    words: LayerWords | None = None
    ago: Float[Tensor, "*batch 1 layer c ly lx"] | None = None
    after: SweepsState | None = None
    floor: Floor | None = None

    def picture(self, problem: Problem) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        """Return the layers, made of words if there is nothing else."""
        words = problem.constants.words
        if self.layers is not None or self.words is None or words is None:
            assert self.layers is not None
            return self.layers
        return self.words.now[..., : problem.layer_shape[-1]].to(torch.float32) / words.most


LearnedSweepsState = SweptState | HalfState | Balanced | LearnedState | Unbegun


@dataclass(frozen=True)
class LearnedSweeps:
    """Accelerated sweeps in 16-bit words, first of pictures of half size.

        P_k <- clamp((b_k - sum_j G_kj P_j) / A_k^T W A_k 1),  layer by layer, inner ones first,
        from clamp(P + push (P - P of one sweep ago))

    Sweeps find what is near, and what is at bounds. What is far apart is near at half size, where a
    sweep costs a fifth (see `half_size`), and where views are many, nearer at half the half. The
    smallest size begins with the balanced start e, larger ones with what was found below, Q:

        P = e up(Q / e of half size)

    How dark pixels of half size may be is told by those of whole size (`floor_of`).

    Where half size serves not, a learned step comes first: in the Fourier domain what is far apart
    is found at once. Without the views and in words, four sweeps cost less than such a step.

    The layers of any number of iterations have been swept over. Behind `early` ones, where half
    size tells no more, and from layers that are given, an iteration is four sweeps. The push grows
    with the sweeps. Where rounding would be seen, behind 131 of 5x5 views and three layers, others
    in floats follow (`Sweeps`).

    Args:
        direct: the step; of several, all come before sweeps.
        sweeps: of an iteration, which then takes about as long as a step; and behind that.
        early: iterations that go on at half size,
        inner: each by so many sweeps at every smaller size,
        outer: and by so many of whole size, and one more before all.
        growth: of the push: growth n / (n + 2) for the nth behind the first sweep.
        momentum: the largest push.
        gray: sweeps over the mean of all colours before those of the smallest size; where there are
            none, a step is made.
    """

    direct: LearnedAdmm
    sweeps: int = 4
    early: int = 5
    inner: int = 6
    outer: int = 2
    growth: float = 1.8
    momentum: float = 0.95
    gray: int = 28

    def init(
        self, problem: Problem, start: LearnedSweepsState | Tensor | None
    ) -> LearnedSweepsState:
        if isinstance(start, HalfState) and start.count > 0:
            start = self.layers(problem, start)
        if isinstance(start, SweptState):
            return start
        if isinstance(start, Tensor):
            return SweptState(start.contiguous())
        if isinstance(start, LearnedState):
            return self.direct.init(problem, start)
        return self._begin(problem, None)

    def _begin(self, problem: Problem, floor: Floor | None) -> HalfState | Balanced | Unbegun:
        """Return what nothing is known of yet, at half size and below."""
        half = half_of(problem)
        if half is None:
            return Unbegun() if floor is None else Balanced(floor)
        small = at_half_size(problem, half)
        own = floor_of(problem, half, small, floor) if self.gray > 0 else None
        below = self._begin(small, own)
        return HalfState(half, small, below, floor=floor)

    def step(self, problem: Problem, state: LearnedSweepsState) -> LearnedSweepsState:
        return self.steps(problem, state, 1)

    def steps(self, problem: Problem, state: LearnedSweepsState, count: int) -> LearnedSweepsState:
        if isinstance(state, SweptState | Balanced):
            return self._swept(problem, state, self.sweeps * count)
        if isinstance(state, HalfState):
            early = min(count, self.early - state.count)
            inner = self._below.steps(state.problem, state.state, early)
            known = replace(state, state=inner, count=state.count + early)
        else:
            made = 0 if isinstance(state, Unbegun) else state.count
            early = max(0, min(count, len(self.direct.full) - made))
            known = self.direct.steps(problem, state, early)
        if early == count:
            return known
        sweeps = self._behind(known) + self.sweeps * (count - early)
        return self._swept(problem, self._begun(problem, known), sweeps)

    def layers(
        self, problem: Problem, state: LearnedSweepsState
    ) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        if isinstance(state, SweptState):
            return state.picture(problem)
        if isinstance(state, Unbegun | Balanced) or state.count == 0:
            return problem.even_start().clamp(*problem.bounds)
        return self._found(problem, state).picture(problem)

    def _found(self, problem: Problem, state: SweptState | HalfState | LearnedState) -> SweptState:
        """Return what is found by what is known so far."""
        if isinstance(state, SweptState):
            return state
        return self._swept(problem, self._begun(problem, state), self._behind(state))

    @cached_property
    def _below(self) -> "LearnedSweeps":
        """What makes iterations at half size."""
        return replace(self, sweeps=self.inner, outer=self.inner)

    def _behind(self, state: HalfState | LearnedState | Unbegun) -> int:
        """Return how many sweeps follow what is known so far."""
        at_half = isinstance(state, HalfState)
        return self.outer * state.count + 1 if at_half else self.sweeps

    def _begun(
        self, problem: Problem, state: HalfState | LearnedState | Unbegun
    ) -> SweptState | Enlarged:
        """Return layers as they are before they are clamped."""
        if isinstance(state, HalfState):
            found = self._below._found(state.problem, state.state)
            words = None if found.words is None else found.words.now
            given = problem, state.half, state.problem, found.layers, words, state.floor
            return Enlarged(*given)
        if isinstance(state, LearnedState) and state.after is None:
            return SweptState(problem.gram.from_torus(state.shadow))
        return SweptState(self.direct.layers(problem, state))

    def _swept(
        self, problem: Problem, state: SweptState | Enlarged | Balanced, count: int
    ) -> SweptState:
        """Return the state after so many sweeps more."""
        words = None if is_plain() else problem.constants.words
        if not isinstance(state, SweptState):
            begun = None if words is None else self._begun_in_words(problem, words, state)
            if words is not None and begun is not None:
                known = SweptState(floor=state.floor)
                known = self._in_words(problem, words, begun, known, min(count, _enough(words)))
                return self._swept(problem, known, count - known.count)
            state = SweptState(self._begun_plainly(problem, state), floor=state.floor)
        left = min(count, max(0, _enough(problem.constants.words) - state.count))
        if left > 0 and words is not None:
            begun = state.words or state.picture(problem)
            state = self._in_words(problem, words, begun, state, left)
        elif left > 0:
            state = _swept_plainly(problem, state, self._pushes(state.count, left))
        if left == count:
            return state
        sweeps = Sweeps(momentum=self.momentum, sweeps=count - left)
        after = sweeps.step(problem, sweeps.init(problem, state.after or state.picture(problem)))
        return SweptState(after.layers, state.count + count - left, after=after)

    def _begun_in_words(
        self, problem: Problem, words: Words, state: Enlarged | Balanced
    ) -> Enlargement | None:
        """Return what compiled loops make layers of that sweeps begin at, behind those over gray.

        P = e Q / e of gray
        """
        if isinstance(state, Enlarged):
            return state.words
        assert state.floor.dtype == torch.uint16
        seen, floor = gray_words(problem.back_projected_words), gray_words(state.floor)
        rest = problem.rest_of_words
        begun = balanced(words, rest.mean(axis=1, keepdims=True))
        pushes = self._pushes(0, min(self.gray, _enough(words)))
        _, found = swept(words, seen, begun, pushes, 0, floor)
        return coloured(HalfWords(words, found.now, seen), rest)

    def _begun_plainly(self, problem: Problem, state: Enlarged | Balanced) -> Tensor:
        """Return the same as layers."""
        if isinstance(state, Enlarged):
            return state.layers
        gray = replace(problem, views=KeptViews(problem.views.all().mean(dim=-3, keepdim=True)))
        start, floor = gray.even_start(), state.floor.mean(dim=-3, keepdim=True)
        begun = SweptState(start, floor=floor)
        found = _swept_plainly(gray, begun, self._pushes(0, self.gray)).picture(gray)
        return problem.even_start() * (found + _DARK) / (start + _DARK)

    def _in_words(
        self,
        problem: Problem,
        words: Words,
        begun: Tensor | LayerWords | Enlargement,
        known: SweptState,
        count: int,
    ) -> SweptState:
        pushes, seen = self._pushes(known.count, count), problem.back_projected_words
        layers, made = swept(words, seen, begun, pushes, known.count, known.floor)
        return SweptState(layers, known.count + count, made, floor=known.floor)

    def _pushes(self, made: int, count: int) -> Sequence[float]:
        numbers = range(made, made + count)
        return [min(self.momentum, self.growth * n / (n + 2)) for n in numbers]


def _enough(words: Words | None) -> int:
    """Return how many sweeps words are fine enough for."""
    return 0 if words is None else words.most // _ROUNDING


def serves_words(problem: Problem) -> bool:
    """Whether `LearnedSweeps` serves: light adds up, on a processor, in single precision.

    Views stand in a grid, count alike, look at whole pixels, are few enough for words, and no
    brighter than layers.
    """
    is_light = problem.bounds == (0, 1) and problem.subframes == 1
    if not is_light or not isinstance(problem.link, Additive) or problem.device.type != "cpu":
        return False
    fits = problem.views.like.dtype == torch.float32 and problem.constants.words is not None
    return fits and _are_within(problem)


def _are_within(problem: Problem) -> bool:
    """Whether no light that a pixel is to show is more than its views can be, 1 each."""
    views, table = problem.views, problem.views.table
    if views.is_whole:
        return table is None or bool(table.max() <= 1)
    return bool(problem.back_projected.amax() <= _BRIGHTEST * sum(problem.weights))


def _swept_plainly(problem: Problem, state: SweptState, pushes: Sequence[float]) -> SweptState:
    """As words do, but for their rounding."""
    low, high = problem.bounds

    def clamped(layers: Tensor, floor: Tensor | None = None) -> Tensor:
        return layers.clamp(low, high) if floor is None else layers.clamp(max=high).maximum(floor)

    layers, floor = clamped(state.picture(problem)), state.floor
    ago = layers if state.ago is None else state.ago
    for push in pushes:
        ahead = clamped(layers + push * (layers - ago), floor)
        for k in problem.projection.inner_first:
            own = None if floor is None else floor[..., k, :, :, :]
            ahead[..., k, :, :, :] = clamped(best_layer(problem, ahead, k), own)
        layers, ago = ahead, layers
    return SweptState(layers, state.count + len(pushes), ago=ago, floor=floor)
