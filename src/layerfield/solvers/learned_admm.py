"""A few steps of the direct solver, each with constants of its own that were learned."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, field, replace
from functools import partial

from jaxtyping import Float
from torch import Tensor

from layerfield.frequencies import Apart, Spectral
from layerfield.kernels.blends import Blend, Shares
from layerfield.kernels.small_steps import steps_at_once
from layerfield.solve import Problem
from layerfield.solvers.fourier_admm import AdmmState, FourierAdmm, right_hand_side

COARSE = 4  # times larger are the pixels of the coarse steps
BALANCE = 0.003  # as of the direct solver
OVERRELAXED = 1.6  # relaxation that leads nowhere astray; constants of few layers go beyond
_LAYERS = 4  # that may go as far as they want
_LEAST = 8  # pixels of a coarse torus; smaller pictures go without


@dataclass(frozen=True)
class Constants:
    """What one step of ADMM depends on.

    Args:
        penalty: rho as a share of the sum of view weights.
        relaxation: a, how far to go.
        trust: factor of the dual that enters the step.
        kept: share of the dual that the next step is given.
        momentum: share of the last change that is made once more.
    """

    penalty: float
    relaxation: float
    trust: float
    kept: float
    momentum: float

    def among(self, layers: int) -> "Constants":
        """Return the constants of a step of so many layers; see `stride`."""
        share, beyond = stride(layers), max(self.relaxation - OVERRELAXED, 0.0)
        relaxation = self.relaxation - (1 - share**2) * beyond
        return replace(self, relaxation=relaxation, momentum=share * self.momentum)


def stride(layers: int) -> float:
    """Return how boldly many layers go, as a share of what few do.

    Each layer goes as if the others stayed where they are. Where many go at once, their sum or
    product goes too far: with the constants of few layers, eight end farther from the optimum after
    twelve steps than after eight.
    """
    return min(1.0, _LAYERS / layers)


@dataclass(frozen=True, eq=False)
class LearnedState:
    """Iterate and dual, s = z + u, those of one step ago, and the learned steps made.

    `after` is the state of what goes on behind the last of them; then it alone counts.
    """

    shadow: Float[Tensor, "*batch 1 layer c ty tx"]
    before: Float[Tensor, "*batch 1 layer c ty tx"] | None = None
    count: int = 0
    after: AdmmState | None = None


@dataclass(frozen=True, eq=False)
class LearnedAdmm:
    """Minimise 1/2 ||A P - L||^2_W over a box, as well as a given number of steps can.

        z = clamp(s),  u = s - z,  x = (G + rho I)^-1 (b + rho (z - trust u))
        s <- z + kept u + a (x - z) + momentum (s - s of one step ago)

    b = A^T W L + band: views are completed around their borders by what the layers show there.
    Constants that never change lead to the optimum, in the end (ADMM); these change from step to
    step, for the least error after the last.

    The first step starts from b / (W K): every layer shows what its viewers see on average. That
    spectrum is at hand. A share of its low frequencies, where light has to find its layer among
    bounds, is taken out (`Spectral.window`) and solved by itself on pixels four times as large, by
    steps that cost a sixteenth each.

    Behind the last learned step, and from layers that are given, the direct solver goes on.

    Args:
        full: constants of every step, of displays of few layers; of more see `Constants.among`.
        coarse: constants of the steps on large pixels.
        after: what goes on.
    """

    full: Sequence[Constants]
    coarse: Sequence[Constants]
    after: FourierAdmm = field(default_factory=FourierAdmm)

    def init(self, problem: Problem, start: LearnedState | Tensor | None) -> LearnedState:
        if start is None:
            return LearnedState(problem.even_start(problem.gram.torus))
        if isinstance(start, LearnedState):
            return start if start.after else self._handed_on(problem, self.layers(problem, start))
        return self._handed_on(problem, start)

    def _handed_on(self, problem: Problem, layers: Tensor) -> LearnedState:
        after = self.after.init(problem, layers)
        return LearnedState(after.shadow, None, len(self.full), after)

    def step(self, problem: Problem, state: LearnedState) -> LearnedState:
        if state.count == len(self.full):
            known = state.after or self._handed_on(problem, self.layers(problem, state)).after
            assert known is not None
            after = self.after.step(problem, known)
            return LearnedState(after.shadow, None, state.count, after)
        if state.count == 0:
            return LearnedState(self._first(problem, state.shadow), None, 1)
        constants = self.full[state.count].among(problem.layer_count)
        moved = after_step(problem, state.shadow, state.before, constants)
        return LearnedState(moved, state.shadow, state.count + 1)

    def layers(
        self, problem: Problem, state: LearnedState
    ) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        return problem.gram.from_torus(state.shadow).clamp(*problem.bounds)

    def _first(self, problem: Problem, shadow: Tensor) -> Tensor:
        constants, spectral = self.full[0].among(problem.layer_count), problem.gram.spectral
        share = 1 / (spectral.weight * len(spectral.symbol))
        a, rho = constants.relaxation, constants.penalty * spectral.weight
        data = right_hand_side(problem, shadow, Shares(0, 0, 1))
        grid, apart = coarse_grid(spectral) if self.coarse else None, None
        if grid is not None:
            solve = partial(self._solved_coarsely, grid, bounds=problem.bounds)
            apart = Apart(grid, solve)
        # z + a (x - z) with z = share b, u = 0
        gain, kept = a * (1 / rho + share), (1 - a) * share
        return spectral.solved_pixels(data, constants.penalty, BALANCE, gain, kept, apart)

    def _solved_coarsely(
        self, coarser: Spectral, seen: Tensor, bounds: tuple[float, float]
    ) -> Tensor:
        """Return the spectrum of s after all coarse steps."""
        data, number = coarser.to_pixels(seen).div_(coarser.pixels), len(coarser.symbol)
        steps, made = [each.among(number) for each in self.coarse], None
        if coarser.serves(data):
            known = (data, coarser.symbol, coarser.by_row, coarser.weight, BALANCE, bounds)
            made = steps_at_once(*known, [astuple(each) for each in steps])
        if made is None:
            made, before = data / (coarser.weight * number), None
            for constants in steps:
                right = Blend(_right_shares(coarser, constants), made, bounds, data)
                made, before = _moved(coarser, right, made, before, bounds, constants), made
        return coarser.to_frequencies(made).mul_(coarser.pixels)


def after_step(
    problem: Problem,
    shadow: Float[Tensor, "*batch 1 layer c ty tx"],
    before: Float[Tensor, "*batch 1 layer c ty tx"] | None,
    constants: Constants,
) -> Float[Tensor, "*batch 1 layer c ty tx"]:
    """Return s after a step."""
    spectral = problem.gram.spectral
    right = right_hand_side(problem, shadow, _right_shares(spectral, constants))
    return _moved(spectral, right, shadow, before, problem.bounds, constants)


def coarse_grid(spectral: Spectral) -> Spectral | None:
    """Return the grid of the coarse steps, or None where the picture is too small for one."""
    coarser = spectral.coarser(COARSE)
    height, width = coarser.torus
    return coarser if min(width if coarser.by_row else height, width) >= _LEAST else None


def _right_shares(spectral: Spectral, constants: Constants) -> Shares:
    """Of z - trust (s - z) + b / rho."""
    other = 1 / (constants.penalty * spectral.weight)
    return Shares(1 + constants.trust, -constants.trust, other)


def _moved(
    spectral: Spectral,
    right: Tensor | Blend,
    shadow: Tensor,
    before: Tensor | None,
    bounds: tuple[float, float],
    constants: Constants,
) -> Tensor:
    """Return s after a step, from z - trust u + b / rho."""
    a, kept = constants.relaxation, constants.kept
    momentum = 0.0 if before is None else constants.momentum
    # a x + (1 - a) z + kept (s - z) + momentum (s - s of one step ago)
    shares = Shares(1 - a - kept, kept + momentum, -momentum)
    rest = Blend(shares, shadow, bounds, before)
    return spectral.solved_pixels(right, constants.penalty, BALANCE, gain=a, added=rest)
