"""A few steps of the direct solver, each with constants of its own that were learned."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

from jaxtyping import Float
from torch import Tensor

from layerfield.frequencies import Apart, Spectral
from layerfield.kernels.blends import Blend, Shares
from layerfield.kernels.small_steps import Coarse, steps_at_once
from layerfield.kernels.starts import shared_rim
from layerfield.kernels.steps import BalancedStart, steps_in_one_call
from layerfield.problem import Problem
from layerfield.solve import OutlivesViews
from layerfield.solvers.admm_steps import (
    Constants,
    after_steps,
    moved,
    right_hand_side,
    right_shares,
)
from layerfield.solvers.fourier_admm import AdmmState, FourierAdmm
from layerfield.solvers.relief import Relief

COARSE = 4  # times larger are the pixels of the coarse steps
BALANCE = 0.003  # as of the direct solver
# Least penalty on large pixels. Softer ones serve small scenes, but let light answer to what is far
# away: worse on large pictures, and layers flicker when something scrolls in.
SOFTEST = 0.04
_LEAST = 8  # pixels of a coarse torus; smaller pictures go without


@dataclass(frozen=True, eq=False)
class LearnedState(OutlivesViews):
    """Iterate and dual, s = z + u, those of one step ago, and the learned steps made.

    `after` is the state of what goes on behind the last of them; then it alone counts.
    """

    shadow: Float[Tensor, "*batch 1 layer c ty tx"]
    before: Float[Tensor, "*batch 1 layer c ty tx"] | None = None
    count: int = 0
    after: AdmmState | None = None


@dataclass(frozen=True, eq=False)
class Unbegun(OutlivesViews):
    """No step was made: layers are the balanced start, of which the first step needs a rim."""


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

    Behind the first step a network hands on what layers cannot hold, see `Relief`.
    Behind the last learned step, and from layers that are given, the direct solver goes on.

    Args:
        full: constants of every step, one at the least, of displays of few layers; of more see
            `Constants.among`.
        coarse: constants of the steps on large pixels.
        relief: what is behind the first step.
        after: what goes on.
    """

    full: Sequence[Constants]
    coarse: Sequence[Constants]
    relief: Relief | None = None
    after: FourierAdmm = field(default_factory=FourierAdmm)

    def init(
        self, problem: Problem, start: LearnedState | Unbegun | Tensor | None
    ) -> LearnedState | Unbegun:
        if start is None or isinstance(start, Unbegun):
            return Unbegun()
        if isinstance(start, LearnedState):
            return start if start.after else self._handed_on(problem, self.layers(problem, start))
        return self._handed_on(problem, start)

    def _handed_on(self, problem: Problem, layers: Tensor) -> LearnedState:
        after = self.after.init(problem, layers)
        return LearnedState(after.shadow, None, len(self.full), after)

    def step(self, problem: Problem, state: LearnedState | Unbegun) -> LearnedState | Unbegun:
        return self.steps(problem, state, 1)

    def steps(
        self, problem: Problem, state: LearnedState | Unbegun, count: int
    ) -> LearnedState | Unbegun:
        if count == 0:
            return state
        if isinstance(state, Unbegun):
            rows = self._rows(problem, 0, count)
            made = LearnedState(*self._from_start(problem, rows), len(rows))
            return self.steps(problem, made, count - len(rows))
        if state.after is not None or state.count >= len(self.full):
            known = state.after or self._handed_on(problem, self.layers(problem, state)).after
            assert known is not None
            after = self.after.steps(problem, known, count)
            return LearnedState(after.shadow, None, state.count, after)
        rows, shadow = self._rows(problem, state.count, count), state.shadow
        made = after_steps(problem, shadow, state.before, rows, BALANCE)
        return self.steps(problem, LearnedState(*made, state.count + len(rows)), count - len(rows))

    def _rows(self, problem: Problem, made: int, count: int) -> list[Constants]:
        """Return the constants of so many steps behind those made, or of what is left."""
        return [each.among(problem.layer_count) for each in self.full[made:][:count]]

    def layers(
        self, problem: Problem, state: LearnedState | Unbegun
    ) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        if isinstance(state, Unbegun):
            return problem.even_start().clamp(*problem.bounds)
        return problem.gram.clamped_from_torus(state.shadow, problem.bounds)

    def _from_start(
        self, problem: Problem, rows: Sequence[Constants]
    ) -> tuple[Tensor, Tensor | None]:
        """Return s after the first steps, and of one step before."""
        spectral, sides, data = problem.gram.spectral, problem.gram.sides, problem.back_projected
        grid = coarse_grid(spectral) if self.coarse else None
        if grid is not None and sides is not None and spectral.serves(data):
            coarse = self._coarse(grid, problem.bounds)
            network = None if self.relief is None else self.relief.network
            start = BalancedStart(*problem.even_shares, coarse, grid.window, network)
            system = spectral.system(BALANCE, problem.bounds)
            made = steps_in_one_call(start, None, data, system, sides, rows)
            if made is not None:
                return made
        first = self._relieve_(problem, self._first(problem, rows[0], grid))
        return after_steps(problem, first, None, rows[1:], BALANCE)

    def _relieve_(self, problem: Problem, shadow: Tensor) -> Tensor:
        """Return what the network makes of s behind the first step, in place."""
        if self.relief is None:
            return shadow
        gram = problem.gram
        by_row = gram.spectral.by_row
        return self.relief.relieve_(shadow, gram.layer_size, problem.bounds, by_row=by_row)

    def _first(self, problem: Problem, constants: Constants, grid: Spectral | None) -> Tensor:
        """Return s after the first step."""
        spectral, apart = problem.gram.spectral, None
        share = 1 / (spectral.weight * len(spectral.symbol))
        a, rho = constants.relaxation, constants.penalty * spectral.weight
        data = right_hand_side(problem, self._rim(problem), Shares(0, 0, 1))
        if grid is not None:
            solve = partial(self._solved_coarsely, grid, bounds=problem.bounds)
            apart = Apart(grid, solve)
        # z + a (x - z) with z = share b, u = 0
        gain, kept = a * (1 / rho + share), (1 - a) * share
        return spectral.solved_pixels(data, constants.penalty, BALANCE, gain, kept, apart)

    def _rim(self, problem: Problem) -> Tensor:
        """Return the balanced start, of which no more is needed here than what strips show."""
        gram, data = problem.gram, problem.back_projected
        if gram.sides is None or not gram.spectral.serves(data):
            return problem.even_start(gram.torus, rim=True)
        return shared_rim(data, *problem.even_shares, gram.torus, gram.sides)

    def _coarse(self, grid: Spectral, bounds: tuple[float, float]) -> Coarse:
        """Return the coarse steps for compiled loops."""
        return Coarse(grid.system(BALANCE, bounds), self._coarse_steps(grid), grid.pixels)

    def _coarse_steps(self, grid: Spectral) -> list[Constants]:
        known = [each.among(len(grid.symbol)) for each in self.coarse]
        return [each._replace(penalty=max(each.penalty, SOFTEST)) for each in known]

    def _solved_coarsely(self, grid: Spectral, seen: Tensor, bounds: tuple[float, float]) -> Tensor:
        """Return the spectrum of s after all coarse steps."""
        if grid.serves(seen):
            made = steps_at_once(seen, self._coarse(grid, bounds))
            if made is not None:
                return made
        data, number, before = grid.low_to_pixels(seen), len(grid.symbol), None
        made = data / (grid.weight * number)
        for constants in self._coarse_steps(grid):
            right = Blend(right_shares(grid, constants), made, bounds, data)
            made, before = moved(grid, right, made, before, bounds, constants, BALANCE), made
        return grid.to_low(made)


def coarse_grid(spectral: Spectral) -> Spectral | None:
    """Return the grid of the coarse steps, or None where the picture is too small for one."""
    coarser = spectral.coarser(COARSE)
    height, width = coarser.torus
    return coarser if min(width if coarser.by_row else height, width) >= _LEAST else None
