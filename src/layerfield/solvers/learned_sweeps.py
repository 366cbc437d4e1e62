"""A few learned steps, then sweeps layer by layer in words, where views stand in a grid."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.compiled import is_plain
from layerfield.kernels.word_sweeps import LayerWords, swept
from layerfield.kernels.words import Words
from layerfield.links import Additive
from layerfield.solve import Problem
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


@dataclass(frozen=True)
class LearnedSweeps:
    """Learned steps, and accelerated sweeps behind them, in 16-bit words.

        P_k <- clamp((b_k - sum_j G_kj P_j) / A_k^T W A_k 1),  layer by layer, from
        clamp(P + push (P - P of one sweep ago))

    Steps in the Fourier domain are quick to find what is far apart, sweeps what is near, and at
    bounds; without the views and in words, four cost less than a step. The layers of any number
    of steps have been swept over; behind the last of them an iteration is four sweeps more, and
    so it is from layers that are given. The push grows with the sweeps. Where rounding
    would be seen, behind 131 of 5x5 views and three layers, others in floats follow (`Sweeps`).

    Args:
        direct: the steps.
        sweeps: of an iteration, which then takes about as long as a step.
        growth: of the push: growth n / (n + 2) for the nth behind the first sweep.
        momentum: the largest push.
    """

    direct: LearnedAdmm
    sweeps: int = 4
    growth: float = 1.8
    momentum: float = 0.95

    def init(
        self, problem: Problem, start: SweptState | LearnedState | Unbegun | Tensor | None
    ) -> SweptState | LearnedState | Unbegun:
        if isinstance(start, SweptState):
            start = start.layers  # not how they moved, which may have been for other views
        if isinstance(start, Tensor):
            return SweptState(start.detach().to(problem.back_projected).contiguous())
        return self.direct.init(problem, start)

    def step(
        self, problem: Problem, state: SweptState | LearnedState | Unbegun
    ) -> SweptState | LearnedState | Unbegun:
        return self.steps(problem, state, 1)

    def steps(
        self, problem: Problem, state: SweptState | LearnedState | Unbegun, count: int
    ) -> SweptState | LearnedState | Unbegun:
        if isinstance(state, SweptState):
            return self._swept(problem, state, self.sweeps * count)
        made = 0 if isinstance(state, Unbegun) else state.count
        learned = max(0, min(count, len(self.direct.full) - made))
        known = self.direct.steps(problem, state, learned)
        if learned == count:
            return known
        sweeps = self.sweeps * (1 + count - learned)
        return self._swept(problem, self._begun(problem, known), sweeps)

    def layers(
        self, problem: Problem, state: SweptState | LearnedState | Unbegun
    ) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        if isinstance(state, SweptState):
            return state.layers
        if isinstance(state, Unbegun):
            return self.direct.layers(problem, state)
        return self._swept(problem, self._begun(problem, state), self.sweeps).layers

    def _begun(self, problem: Problem, state: LearnedState | Unbegun) -> SweptState:
        """Return the layers of learned steps, as they are before they are clamped."""
        if isinstance(state, LearnedState) and state.after is None:
            return SweptState(problem.gram.from_torus(state.shadow))
        return SweptState(self.direct.layers(problem, state))

    def _swept(self, problem: Problem, state: SweptState, count: int) -> SweptState:
        """Return the state after so many sweeps more."""
        words = problem.constants.words
        enough = 0 if words is None else words.most // _ROUNDING
        left = min(count, max(0, enough - state.count))
        known = state if words is None or not left else self._in_words(problem, words, state, left)
        if left == count:
            return known
        sweeps = Sweeps(momentum=self.momentum, sweeps=count - left)
        after = sweeps.step(problem, sweeps.init(problem, known.after or known.layers))
        return SweptState(after.layers, state.count + count, after=after)

    def _in_words(
        self, problem: Problem, words: Words, state: SweptState, count: int
    ) -> SweptState:
        numbers = range(state.count, state.count + count)
        pushes = [min(self.momentum, self.growth * n / (n + 2)) for n in numbers]
        if is_plain():
            return _swept_plainly(problem, state, pushes)
        begun = state.words or state.layers
        layers, made = swept(words, problem.back_projected, begun, pushes, state.count)
        return SweptState(layers, state.count + count, made)


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
        for k in range(problem.layer_count):
            ahead[..., k, :, :, :] = best_layer(problem, ahead, k)
        layers, ago = ahead, layers
    return SweptState(layers, state.count + len(pushes), ago=ago)
