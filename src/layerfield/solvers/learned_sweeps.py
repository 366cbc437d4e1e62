"""A learned step, then sweeps layer by layer in words, where views stand in a grid."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.half_size import Enlarged, HalfState, at_half_size, half_of
from layerfield.kernels.compiled import is_plain
from layerfield.kernels.half_words import Enlargement
from layerfield.kernels.word_sweeps import LayerWords, swept
from layerfield.kernels.words import Words
from layerfield.links import Additive
from layerfield.problem import Problem
from layerfield.solvers.learned_admm import LearnedAdmm, LearnedState, Unbegun
from layerfield.solvers.sweeps import Sweeps, SweepsState, best_layer

_ROUNDING = 10  # numbers of a word for each sweep: of more, what rounding leaves is seen
_BRIGHTEST = 1 + 1e-5  # of a view; sums of floats are rounded


@dataclass(frozen=True, eq=False)
class SweptState:
    """Layers after sweeps, how many those are, and what goes on.

    That is words, or P of one sweep ago where there are none, or the state of sweeps in floats.
    """

    layers: Float[Tensor, "*batch 1 layer c ly lx"]
    count: int = 0
    words: LayerWords | None = None
    ago: Float[Tensor, "*batch 1 layer c ly lx"] | None = None
    after: SweepsState | None = None


LearnedSweepsState = SweptState | HalfState | LearnedState | Unbegun


@dataclass(frozen=True)
class LearnedSweeps:
    """A learned step, and accelerated sweeps behind it, in 16-bit words.

        P_k <- clamp((b_k - sum_j G_kj P_j) / A_k^T W A_k 1),  layer by layer, inner ones first,
        from clamp(P + push (P - P of one sweep ago))

    Steps in the Fourier domain are quick to find what is far apart, sweeps what is near, and at
    bounds; without the views and in words, four cost less than a step. What is far apart is found
    at half size, where all costs a quarter (see `half_size`): by a step, by sweeps behind it, and,
    where views are many, at half the half. From there layers of whole size begin,

        P = e + up(Q - e of half size)

    with e the balanced start. Where half size serves not, the step is of whole size. The layers of
    any number of iterations have been swept over; behind `early` ones, and from layers that are
    given, an iteration is four sweeps. The push grows with the sweeps. Where rounding would be
    seen, behind 131 of 5x5 views and three layers, others in floats follow (`Sweeps`).

    Args:
        direct: the step; of several, all come before sweeps.
        sweeps: of an iteration, which then takes about as long as a step; and behind that.
        early: iterations that go on at half size,
        inner: each by so many there,
        outer: and by so many sweeps of whole size; of the first twice as many.
        growth: of the push: growth n / (n + 2) for the nth behind the first sweep.
        momentum: the largest push.
    """

    direct: LearnedAdmm
    sweeps: int = 4
    early: int = 5
    inner: int = 3
    outer: int = 2
    growth: float = 1.8
    momentum: float = 0.95

    def init(
        self, problem: Problem, start: LearnedSweepsState | Tensor | None
    ) -> LearnedSweepsState:
        if isinstance(start, HalfState):
            start = self.layers(problem, start) if start.count > 0 else None
        if isinstance(start, SweptState):
            return start
        if isinstance(start, Tensor):
            return SweptState(start.contiguous())
        half = half_of(problem)
        if half is None:
            return self.direct.init(problem, start)
        small = at_half_size(problem, half)
        return HalfState(half, small, self.init(small, None))

    def step(self, problem: Problem, state: LearnedSweepsState) -> LearnedSweepsState:
        return self.steps(problem, state, 1)

    def steps(self, problem: Problem, state: LearnedSweepsState, count: int) -> LearnedSweepsState:
        if isinstance(state, SweptState):
            return self._swept(problem, state, self.sweeps * count)
        if isinstance(state, HalfState):
            early = min(count, self.early - state.count)
            inner = self.steps(state.problem, state.state, self.inner * early)
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
            return state.layers
        if isinstance(state, Unbegun) or state.count == 0:
            return problem.even_start().clamp(*problem.bounds)
        return self._found(problem, state).layers

    def _found(self, problem: Problem, state: LearnedSweepsState) -> SweptState:
        """Return what is found by what is known so far."""
        if isinstance(state, SweptState):
            return state
        return self._swept(problem, self._begun(problem, state), self._behind(state))

    def _behind(self, state: HalfState | LearnedState | Unbegun) -> int:
        """Return how many sweeps follow what is known so far."""
        at_half = isinstance(state, HalfState)
        return self.outer * (state.count + 1) if at_half else self.sweeps

    def _begun(
        self, problem: Problem, state: HalfState | LearnedState | Unbegun
    ) -> SweptState | Enlarged:
        """Return layers as they are before they are clamped."""
        if isinstance(state, HalfState):
            found = self._found(state.problem, state.state)
            words = None if found.words is None else found.words.now
            return Enlarged(problem, state.half, state.problem, found.layers, words)
        if isinstance(state, LearnedState) and state.after is None:
            return SweptState(problem.gram.from_torus(state.shadow))
        return SweptState(self.direct.layers(problem, state))

    def _swept(self, problem: Problem, state: SweptState | Enlarged, count: int) -> SweptState:
        """Return the state after so many sweeps more."""
        words = None if is_plain() else problem.constants.words
        if isinstance(state, Enlarged):
            begun = None if words is None else state.words
            if words is not None and begun is not None:
                known = self._in_words(problem, words, begun, 0, min(count, _enough(words)))
                return self._swept(problem, known, count - known.count)
            state = SweptState(state.layers)
        left = min(count, max(0, _enough(problem.constants.words) - state.count))
        if left > 0 and words is not None:
            begun = state.words or state.layers
            state = self._in_words(problem, words, begun, state.count, left)
        elif left > 0:
            state = _swept_plainly(problem, state, self._pushes(state.count, left))
        if left == count:
            return state
        sweeps = Sweeps(momentum=self.momentum, sweeps=count - left)
        after = sweeps.step(problem, sweeps.init(problem, state.after or state.layers))
        return SweptState(after.layers, state.count + count - left, after=after)

    def _in_words(
        self,
        problem: Problem,
        words: Words,
        begun: Tensor | LayerWords | Enlargement,
        made: int,
        count: int,
    ) -> SweptState:
        pushes = self._pushes(made, count)
        layers, known = swept(words, problem.back_projected_words, begun, pushes, made)
        return SweptState(layers, made + count, known)

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
    layers = state.layers.clamp(*problem.bounds)
    ago = layers if state.ago is None else state.ago
    for push in pushes:
        ahead = (layers + push * (layers - ago)).clamp(*problem.bounds)
        for k in problem.projection.inner_first:
            ahead[..., k, :, :, :] = best_layer(problem, ahead, k)
        layers, ago = ahead, layers
    return SweptState(layers, state.count + len(pushes), ago=ago)
